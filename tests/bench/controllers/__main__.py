"""What the MAS paper measured, on this machine: ``python -m tests.bench.controllers``."""

from __future__ import annotations

import os
import time
from pathlib import Path

import click

from tests.bench.controllers import clock, cpu, handback, links, report, tracking, trip
from tests.bench.controllers.processes import load
from zmav.cli.common import console
from zmav.errors import BadInput, ZmavError
from zmav.process import run, say

ALL = ("links", "trip", "clock", "cpu", "tracking")


@click.command()
@click.option("--only", metavar="NAMES", help=f"Some of {','.join(ALL)}.  [default: all, in half an hour]")
@click.option("--quick", is_flag=True, help="Few samples: to see that it works.")
@click.option("-o", "--output", "folder", metavar="DIR", help="Where bench.json and pictures go.  [default: none]")
def bench(only: str | None, quick: bool, folder: str | None) -> None:
    """Measure controllers as the MAS paper does: links, round trip, clocks, CPU and tracking.

    Flies the embedded 3.2 kg hexarotor under PX4's rules with processes of its own on free ports of this machine, in
    real time: other work on it shows in the figures, and its load is said beside them.
    """
    run(_bench(chosen(only), quick, None if folder is None else Path(folder)))


def chosen(only: str | None) -> tuple[str, ...]:
    """Which are meant; raises :class:`~zmav.errors.BadInput` for one that there is not."""
    if only is None:
        return ALL
    names = [name.strip() for name in only.split(",")]
    for name in names:
        if name not in ALL:
            expected = ", ".join(ALL)
            raise BadInput(
                f"no measurement {name!r}; there are {expected}", field="only", value=name, expected=expected
            )
    return tuple(name for name in ALL if name in names)


async def _bench(names: tuple[str, ...], quick: bool, folder: Path | None) -> int:
    found = report.Report(t=time.time(), processors=os.cpu_count() or 1)
    try:
        for name in names:
            say(f"{name}...")
            before = load()
            try:
                await _measure(name, found, quick)
            except ZmavError as e:
                found.failed[name] = str(e)
            found.loads[name] = before, load()
    finally:  # what was measured until it was interrupted is told
        console().print(report.table(found))
        for path in [] if folder is None else report.save(found, folder):
            say(str(path))
    return 1 if found.failed else 0


async def _measure(name: str, found: report.Report, quick: bool) -> None:
    match name:
        case "links":
            found.links = await links.measure(2.0 if quick else 20.0)
        case "trip":
            async with trip.echoing() as (rig, fake):
                try:
                    found.handback = await handback.measure(rig, fake, 1 if quick else 50)
                finally:  # the trip is measured whatever became of the hand-backs
                    found.trip = await trip.measure(rig, fake, 1.0 if quick else 20.0)
        case "clock":
            found.clock = await clock.measure(2 if quick else 20, 2.0 if quick else 5.0)
        case "cpu":
            found.cpu = await cpu.measure(5.0 if quick else 60.0)
        case _:
            found.tracking = tracking.Tracking({}, {})  # flights that were flown stay, whatever becomes of the others
            await tracking.measure(found.tracking, *((15.0, 4.0, 2.0) if quick else (45.0, 10.0, 5.0)))


if __name__ == "__main__":
    bench()
