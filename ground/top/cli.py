"""``zmav top``: the fleet in the terminal, live; or once, or as JSON for scripts."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys

import click
import msgspec
from rich.style import Style

from ground.top.live import Live, usable
from ground.top.report import Report
from ground.top.screen import Ui, table
from ground.top.watch import Watch
from zmav.cli.common import Work, connected, console
from zmav.client import Client
from zmav.doctor.words import clean


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
@connected
def command(once: bool, as_json: bool, wait: float) -> Work:
    """Watch the fleet in the terminal: who is well, who is not, and why, in words.

    Keys: q quits, up and down select a vehicle, enter shows it in full, / filters by words (names, modes, STALE,
    reasons).

    For scripts: 'zmav top --json | jq ".vehicles[] | select(.level != \\"ok\\") | .name, .reasons[].text"'. It only
    listens and asks; any number of them may run.
    """

    async def show(z: Client) -> None:
        watch = Watch(z)
        if not (once or as_json) and usable(0) and usable(1):
            await Live(watch, 0).run()
            return
        watching = asyncio.create_task(watch.run())
        try:
            await watch.settle(wait)
            report = watch.report()
        finally:
            watching.cancel()
        if as_json:
            click.echo(text(report))
        else:
            _print(report)
            if not once:
                click.echo("no terminal to draw on: shown once; 'zmav top --json' is for scripts", err=True)

    return show


def text(report: Report) -> str:
    """One line of JSON in ASCII: whatever a vehicle says, no terminal that it is printed on takes it for a command."""
    return json.dumps(msgspec.to_builtins(report), allow_nan=False)


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
