"""``zmav top``: the fleet in the terminal, live; or once, or as JSON for scripts."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
from collections.abc import Callable

import click
import msgspec
from rich.style import Style

import zmav
from ground.top.live import Live, usable
from ground.top.report import Report
from ground.top.screen import Ui, table
from ground.top.watch import Watch
from zmav.cli.common import console, fleet_option, run, zenoh_options
from zmav.doctor.words import clean
from zmav.session import SessionSettings


@click.command("top")
@click.option("--once", is_flag=True, help="Print the table once; with --json one document.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document (implies --once).")
@click.option(
    "--wait",
    type=click.FloatRange(0.1, 60.0),
    default=2.0,
    show_default=True,
    help="Seconds at most to listen before something is printed.",
)
@fleet_option
@zenoh_options
def command(once: bool, as_json: bool, wait: float, fleet: str, settings: SessionSettings) -> None:
    """Watch the fleet in the terminal: who is well, who is not, and why, in words.

    Keys: q quits, up and down select a vehicle, enter shows it in full, < and > choose the column to sort by, r turns
    the order round, / filters by words (names, modes, STALE, reasons).

    For scripts: 'zmav top --json | jq ".vehicles[] | select(.level != \\"ok\\") | .name, .reasons[].text"'. It only
    listens and asks; any number of them may run.
    """
    if once or as_json or not (usable(0) and usable(1)):
        run(_show(_print_json if as_json else _print, wait, fleet, settings))
        if not (once or as_json):
            click.echo("no terminal to draw on: shown once; 'zmav top --json' is for scripts", err=True)
    else:
        run(_live(fleet, settings))


async def _live(fleet: str, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        await Live(Watch(z), 0).run()


async def _show(show: Callable[[Report], None], wait: float, fleet: str, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        watch = Watch(z)
        watching = asyncio.create_task(watch.run())
        try:
            await watch.settle(wait)
            show(watch.report())
        finally:
            watching.cancel()


def text(report: Report) -> str:
    """One line of JSON in ASCII: whatever a vehicle says, no terminal that it is printed on takes it for a command."""
    return json.dumps(msgspec.to_builtins(report), allow_nan=False)


def _print_json(report: Report) -> None:
    click.echo(text(report))


def _print(report: Report) -> None:
    """The table, and below it every reason in full: on paper nothing can be scrolled to."""
    out = console()
    width = out.width if sys.stdout.isatty() else max(shutil.get_terminal_size((160, 24)).columns, 40)
    rows = Ui().rows(report)
    lines = table(rows, Ui(), width)
    for vehicle in rows:
        lines += [[(f"{clean(vehicle.name)}: {reason.text}", "")] for reason in vehicle.reasons]
    for agent in report.agents:
        silent = ", SILENT" if agent.stale else ""
        lines.append([(clean(f"agent {agent.name}@{agent.host}: {agent.state} {agent.text}{silent}"), "")])
    colors = out.color_system is not None and not out.no_color
    for line in lines:
        styled = "".join(Style.parse(style).render(piece) if colors else piece for piece, style in line)
        click.echo(styled if colors else styled.rstrip())
