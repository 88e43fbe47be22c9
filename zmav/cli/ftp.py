"""``zmav ftp``: the autopilot's files."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

import zmav
from zmav.cli.common import fleet_option, json_option, run, zenoh_options
from zmav.cli.transfer import finished, say, shown, size, vehicle_of
from zmav.errors import ZmavError
from zmav.session import SessionSettings

ACTIONS = {
    "ls": (0, 1),
    "get": (1, 2),
    "put": (2, 2),
    "rm": (1, 99),
    "mkdir": (1, 1),
    "rmdir": (1, 1),
    "cancel": (0, 0),
}
"""action -> fewest and most paths"""


@click.command("ftp")
@click.argument("vehicle")
@click.argument("action", type=click.Choice(list(ACTIONS)))
@click.argument("paths", nargs=-1)
@fleet_option
@json_option
@zenoh_options
def command(
    vehicle: str, action: str, paths: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """The autopilot's files, by MAVFTP: 'zmav ftp quad1 ls /APM', 'zmav ftp quad1 get @PARAM/param.pck'.

    \b
    ls [PATH]          get PATH [LOCAL]     put LOCAL PATH     rm PATH...
    mkdir PATH         rmdir PATH           cancel: ends the transfer that is under way

    An interrupted get goes on where it stopped. The vehicle finishes by itself what it does on its own link.
    """
    fewest, most = ACTIONS[action]
    if not fewest <= len(paths) <= most:
        raise click.UsageError(f"{action} takes {fewest} path(s)" + (f" to {most}" if most > fewest else ""))
    run(_do(vehicle, action, paths, fleet, as_json, settings))


async def _do(
    name: str, action: str, paths: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    async with vehicle_of(name, fleet, settings) as vehicle:
        if action == "ls":
            await _list(vehicle, paths[0] if paths else "/", as_json)
        elif action == "get":
            await _get(vehicle, paths[0], paths[1] if len(paths) > 1 else None, as_json)
        elif action == "put":
            await _put(vehicle, paths[0], paths[1], as_json)
        elif action == "cancel":
            what = await vehicle.files.cancel()
            say(as_json, {"cancelled": what}, f"cancelled: {what}" if what else "no transfer was under way")
        else:
            await _change(vehicle, action, paths, as_json)


async def _list(vehicle: zmav.Vehicle, path: str, as_json: bool) -> None:
    for entry in sorted(await vehicle.files.list(path), key=lambda e: (not e.directory, e.name)):
        words = f"{'' if entry.size is None else entry.size:>10}  {entry.name}{'/' if entry.directory else ''}"
        say(as_json, msgspec.to_builtins(entry), words)


async def _get(vehicle: zmav.Vehicle, path: str, local: str | None, as_json: bool) -> None:
    progress = shown(as_json)
    try:
        target = await vehicle.files.get(path, local, progress)
    finally:
        finished(progress)
    count = target.stat().st_size
    say(as_json, {"path": path, "file": str(target), "size": count}, f"{path} -> {target} ({size(count)})")


async def _put(vehicle: zmav.Vehicle, local: str, path: str, as_json: bool) -> None:
    if path.endswith("/"):
        path += Path(local).name
    progress = shown(as_json)
    try:
        result = await vehicle.files.put(local, path, progress)
    finally:
        finished(progress)
    checked = "checksum agrees" if result["verified"] else "not checked: the autopilot gives no checksum"
    say(as_json, result, f"{local} -> {path} ({size(result['size'])}, {checked})")


async def _change(vehicle: zmav.Vehicle, action: str, paths: tuple[str, ...], as_json: bool) -> None:
    files = vehicle.files
    work = {"rm": files.remove, "mkdir": files.mkdir, "rmdir": files.rmdir}[action]
    failed = False
    for path in paths:
        try:
            await work(path)
        except ZmavError as e:
            failed = True
            say(as_json, {"path": path, "error": e.code, "message": e.message}, f"{path}: {e.message}")
        else:
            say(as_json, {"path": path, "done": action}, f"{path}: {'made' if action == 'mkdir' else 'removed'}")
    if failed:
        raise SystemExit(1)
