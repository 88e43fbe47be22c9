"""``zmav ftp``: the autopilot's files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click
import msgspec

import zmav
from zmav.cli.common import Work, connected, json_option, size, tell
from zmav.cli.progress import Progress
from zmav.cli.vehicles import one
from zmav.errors import ZmavError

Report = Callable[[dict[str, Any]], None]
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
@json_option
@connected
def command(vehicle: str, action: str, paths: tuple[str, ...], as_json: bool) -> Work:
    """The autopilot's files, by MAVFTP: 'zmav ftp quad1 ls /APM', 'zmav ftp quad1 get @PARAM/param.pck'.

    \b
    ls [PATH]          get PATH [LOCAL]     put LOCAL PATH     rm PATH...
    mkdir PATH         rmdir PATH           cancel: ends the transfer that is under way

    An interrupted get goes on where it stopped. The vehicle finishes by itself what it does on its own link.
    """
    fewest, most = ACTIONS[action]
    if not fewest <= len(paths) <= most:
        raise click.UsageError(f"{action} takes {fewest} path(s)" + (f" to {most}" if most > fewest else ""))

    async def act(z: zmav.Client) -> None:
        target = await one(z, vehicle)
        with Progress(action, quiet=as_json) as progress:
            await _act(target, action, paths, partial(progress.tell, vehicle), as_json)

    return act


async def _act(
    vehicle: zmav.Vehicle,
    action: str,
    paths: tuple[str, ...],
    progress: Callable[[dict[str, Any]], None],
    as_json: bool,
) -> None:
    files = vehicle.files
    if action == "ls":
        entries = await files.list(paths[0] if paths else "/")
        for entry in sorted(entries, key=lambda e: (not e.directory, e.name)):
            text = f"{'' if entry.size is None else entry.size:>10}  {entry.name}{'/' if entry.directory else ''}"
            tell(as_json, msgspec.to_builtins(entry), text)
    elif action == "get":
        path, local = paths[0], paths[1] if len(paths) > 1 else None
        target = await files.get(path, local, progress)
        count = target.stat().st_size
        tell(as_json, {"path": path, "file": str(target), "size": count}, f"{path} -> {target} ({size(count)})")
    elif action == "put":
        local, path = paths
        if path.endswith("/"):
            path += Path(local).name
        result = await files.put(local, path, progress)
        checked = "checksum agrees" if result["verified"] else "not checked: the autopilot gives no checksum"
        tell(as_json, result, f"{local} -> {path} ({size(result['size'])}, {checked})")
    elif action == "cancel":
        what = await files.cancel()
        tell(as_json, {"cancelled": what}, f"cancelled: {what}" if what else "no transfer was under way")
    else:
        await _change(vehicle, action, paths, as_json)


async def _change(vehicle: zmav.Vehicle, action: str, paths: tuple[str, ...], as_json: bool) -> None:
    work = {"rm": vehicle.files.remove, "mkdir": vehicle.files.mkdir, "rmdir": vehicle.files.rmdir}[action]
    failed = False
    for path in paths:
        try:
            await work(path)
        except ZmavError as e:
            failed = True
            tell(as_json, {"path": path, "error": e.code, "message": e.message}, f"{path}: {e.message}")
        else:
            tell(as_json, {"path": path, "done": action}, f"{path}: {'made' if action == 'mkdir' else 'removed'}")
    if failed:
        raise SystemExit(1)
