"""``zmav log``: the autopilot's flight logs."""

from __future__ import annotations

import time
from functools import partial

import click
import msgspec

from zmav import wire
from zmav.cli.common import Work, connected, json_option, size, tell
from zmav.cli.progress import Progress
from zmav.cli.vehicles import one
from zmav.client import Client
from zmav.errors import BadInput


@click.command("log")
@click.argument("vehicle")
@click.argument("action", type=click.Choice(["list", "get", "erase"]))
@click.argument("which", nargs=-1, metavar="[ID | latest | all]...")
@click.option("--to", metavar="PATH", help="File, or directory for several.  [default: the present directory]")
@click.option("--yes", is_flag=True, help="Erase without asking.")
@json_option
@connected
def command(vehicle: str, action: str, which: tuple[str, ...], to: str | None, yes: bool, as_json: bool) -> Work:
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

    async def act(z: Client) -> None:
        logs = (await one(z, vehicle)).logs
        if action == "erase":
            count = await logs.erase()
            tell(as_json, {"erased": count}, f"{count} logs erased")
            return
        there = await logs.list()
        if action == "list":
            for log in there:
                tell(as_json, msgspec.to_builtins(log), f"{log.id:>5}  {_when(log)}  {size(log.size):>9}")
            if not there and not as_json:
                click.echo("no logs")
            return
        chosen = chosen_of(there, which)
        place = f"{to.rstrip('/')}/" if to is not None and len(chosen) > 1 else to
        for log in chosen:
            with Progress(f"log {log.id}", quiet=as_json) as progress:
                target = await logs.get(log, place, partial(progress.tell, vehicle))
            count = target.stat().st_size
            document = {"id": log.id, "file": str(target), "size": count}
            tell(as_json, document, f"log {log.id} -> {target} ({size(count)})")

    return act


def chosen_of(logs: list[wire.LogEntry], which: tuple[str, ...]) -> list[wire.LogEntry]:
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
