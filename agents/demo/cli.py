"""``zmav demo``: flies a demo fleet, and ends with a summary, a recording and a picture."""

from __future__ import annotations

import asyncio
import datetime
import sys
import tempfile
import time
from pathlib import Path
from typing import NoReturn

import click
from rich.console import Console

from agents.demo import picture, report
from agents.demo.play import Play
from agents.demo.stage import DemoFleet
from agents.demo.story import Demo, called, check_extras, demos, find, on_stacks, words
from zmav.children import Children
from zmav.cli.common import console
from zmav.errors import BadConfig, ZmavError
from zmav.hil.binaries import PX4_LAST_ONBOARD
from zmav.process import free_port
from zmav.session import DEFAULT_ROUTER

COPTERS = (None, "arducopter", "px4")
PLANNER = ["swarm", "planner"]
MOST_PX4 = PX4_LAST_ONBOARD + 1
"""those beyond share one link"""


@click.command("demo")
@click.argument("name", default="line")
@click.option("--list", "listed", is_flag=True, help="Show the demos there are.")
@click.option("--ardupilot", metavar="PATH", help="Have a real ArduPilot fly the fleet's: a build tree, or a program.")
@click.option("--px4", metavar="PATH", help="Have a real PX4 fly the fleet's PX4s, or its copters where it has none.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of what is left.  [default: flights/NAME-TIME]",
)
@click.option("--endpoint", help="Where the ground's router listens, to look on with -e.  [default: a free port]")
@click.option("--stay", is_flag=True, help="Start the fleet and its planner, and leave the flying to you.")
def demo(
    name: str,
    listed: bool,
    ardupilot: str | None,
    px4: str | None,
    out: Path | None,
    endpoint: str | None,
    stay: bool,
) -> None:
    """Fly a demo fleet: 'zmav demo swap', or a fleet file of your own with a [demo] table. 0 only if all went well.

    Three copters in a line of routers by default. 'zmav demo --stay' only starts them and their planner, where clients
    look for a router by themselves, until Ctrl-C ends it: then 'zmav http', 'zmav top', 'zmav do quad1 arm' and the
    scripts in ground/examples find them.
    """
    if listed:
        for each in demos():
            click.echo(f"{each.path.stem:<12} {each.story.title}")
        return
    found = find(name)
    check_extras(found)
    if stacks := stack_options(found, ardupilot, px4):
        found = on_stacks(found)
    with (
        tempfile.TemporaryDirectory(prefix="zmav-demo-") as folder,
        Children(at_once=True, by_signals=True) as processes,
    ):
        ground = endpoint or (DEFAULT_ROUTER if stay else f"tcp/127.0.0.1:{free_port()}")
        with DemoFleet(found, processes, Path(folder), ground, stacks) as stage:
            if stay:
                _stay(stage, processes)
            sys.exit(_play(found, stage, processes, _folder(out, found)))


def stack_options(found: Demo, ardupilot: str | None, px4: str | None) -> tuple[str, ...]:
    """What ``zmav sim`` is told so that real stacks fly it; their receivers are exact, as a swarm's must be: a single
    one's error wanders by metres, by which they would truly meet. Raises :class:`BadConfig` where they cannot.
    """
    sims = {name: table.sim or {} for name, table in found.fleet.vehicles.items()}
    copters = [name for name, sim in sims.items() if sim.get("autopilot") in COPTERS]
    px4s = [name for name, sim in sims.items() if sim.get("autopilot") == "px4"]
    hexas = [name for name in px4s or copters if sims[name].get("airframe") == "hexa"]
    demo = found.path.stem
    if px4 and hexas:
        text = f"{hexas[0]} of {demo} is a hexarotor, for which no PX4 is started: fly it without --px4"
        raise BadConfig(text, field="px4", value=px4, expected="a demo of quadrotors")
    if px4 and len(copters) > MOST_PX4:
        text = f"{demo} has {len(copters)} copters, and PX4s that are started have links for {MOST_PX4}"
        raise BadConfig(text, field="px4", value=px4, expected=f"a demo of at most {MOST_PX4} copters")
    given = (*(("--ardupilot", ardupilot) if ardupilot else ()), *(("--px4", px4) if px4 else ()))
    return (*given, "--noise", "rtk") if given else ()


def _folder(out: Path | None, found: Demo) -> Path:
    """Where the recording and the picture go; made."""
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    place = out or Path("flights") / f"{found.path.stem}-{stamp}"
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        text = f"cannot write to {place}: {e.strerror}; choose a folder with --out"
        raise BadConfig(text, field="out", value=str(place), expected="a folder") from e
    return place


def _play(found: Demo, stage: DemoFleet, processes: Children, out: Path) -> int:
    term = console()
    begun = time.monotonic()
    term.print(f"{found.path.stem}: {found.story.title}", style="bold", markup=False)
    play = Play(found, stage, processes, out, term)
    fault: ZmavError | None = None
    try:
        asyncio.run(play.run())
        play.judge()
    except ZmavError as e:
        fault = e
    term.print(report.summary(play))
    report.write(play, out / "summary.json", str(fault) if fault else None)
    _picture(play, out, term)
    term.print(f"summary, recording and picture: {out}", markup=False, highlight=False)
    verdict = "all of it was flown" if fault is None else f"FAILED: {fault}"
    style = "bold green" if fault is None else "bold red"
    term.print(f"{verdict}, in {time.monotonic() - begun:.0f} s", style=style, markup=False, highlight=False)
    return 0 if fault is None else 1


def _picture(play: Play, out: Path, term: Console) -> None:
    if len(play.truth.rows) < 2:
        return
    title = f"{play.demo.path.stem}: {play.demo.story.title}"
    try:
        picture.draw(play.truth.names, play.truth.rows, play.marks, title, out / "tracks.png")
    except ZmavError as e:
        term.print(str(e), markup=False, highlight=False)


def _stay(stage: DemoFleet, processes: Children) -> NoReturn:
    asyncio.run(stage.start())
    planner = next((step for step in stage.demo.story.steps if words(step.start or "")[:2] == PLANNER), None)
    if planner is not None:
        told = words(planner.start or "")
        processes.start(called(planner), *told, environment=stage.environment(planner.on))
    click.echo(f"{', '.join(stage.demo.vehicles)}: the ground's router is at {stage.ground}")
    who = "they, and their planner," if planner is not None else "they"
    click.echo(f"{who} stand ready in a few seconds: fly them from the page of 'zmav http', or look with 'zmav top'")
    click.echo("Ctrl-C ends them")
    while True:
        processes.check()
        time.sleep(0.5)
