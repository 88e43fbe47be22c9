"""``zmav log``: the autopilot's flight logs."""

from __future__ import annotations

import time

import click
import msgspec

import zmav
from zmav import wire
from zmav.cli.common import fleet_option, json_option, run, zenoh_options
from zmav.cli.transfer import finished, say, shown, size, vehicle_of
from zmav.errors import BadInput
from zmav.session import SessionSettings


@click.command("log")
@click.argument("vehicle")
@click.argument("action", type=click.Choice(["list", "get", "erase"]))
@click.argument("which", nargs=-1, metavar="[ID | latest | all]...")
@click.option("--to", metavar="PATH", help="File, or directory for several.  [default: the present directory]")
@click.option("--yes", is_flag=True, help="Erase without asking.")
@fleet_option
@json_option
@zenoh_options
def command(
    vehicle: str,
    action: str,
    which: tuple[str, ...],
    to: str | None,
    yes: bool,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    """The autopilot's flight logs: 'zmav log quad1 list', 'zmav log quad1 get latest', 'zmav log quad1 get 3 4'.

    An interrupted get goes on where it stopped. ArduPilot gives out no logs while it is armed.
    """
    if bool(which) != (action == "get"):
        raise click.UsageError("get takes ids, 'latest' or 'all'; list and erase take nothing")
    for each in which:
        if each not in ("latest", "all") and not each.isdecimal():
            raise click.UsageError(f"{each!r} is no log: give ids, 'latest' or 'all'")
    if action == "erase" and not yes:
        click.confirm(f"Erase all logs of {vehicle}?", abort=True, err=True)
    run(_do(vehicle, action, which, to, fleet, as_json, settings))


async def _do(
    name: str,
    action: str,
    which: tuple[str, ...],
    to: str | None,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    async with vehicle_of(name, fleet, settings) as vehicle:
        if action == "erase":
            count = await vehicle.logs.erase()
            say(as_json, {"erased": count}, f"{count} logs erased")
            return
        logs = await vehicle.logs.list()
        if action == "list":
            for log in logs:
                say(as_json, msgspec.to_builtins(log), f"{log.id:>5}  {_when(log)}  {size(log.size):>9}")
            if not logs and not as_json:
                click.echo("no logs")
            return
        chosen = _chosen(logs, which)
        if to is not None and len(chosen) > 1:
            to = to.rstrip("/") + "/"
        for log in chosen:
            await _get(vehicle, log, to, as_json)


async def _get(vehicle: zmav.Vehicle, log: wire.LogEntry, to: str | None, as_json: bool) -> None:
    progress = shown(as_json)
    try:
        target = await vehicle.logs.get(log, to, progress)
    finally:
        finished(progress)
    count = target.stat().st_size
    say(as_json, {"id": log.id, "file": str(target), "size": count}, f"log {log.id} -> {target} ({size(count)})")


def _chosen(logs: list[wire.LogEntry], which: tuple[str, ...]) -> list[wire.LogEntry]:
    """The logs that are meant, each once."""
    by_id = {log.id: log for log in logs}
    found: dict[int, wire.LogEntry] = {}
    for each in which:
        if each == "all":
            found.update(by_id)
        elif each == "latest" and logs:
            found[logs[-1].id] = logs[-1]
        elif each.isdecimal() and int(each) in by_id:
            found[int(each)] = by_id[int(each)]
        else:
            there = ", ".join(map(str, by_id)) or "none"
            raise BadInput(f"there is no log {each}; there are: {there}", field="which", value=each, expected=there)
    return list(found.values())


def _when(log: wire.LogEntry) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(log.t)) if log.t else "time not known    "
