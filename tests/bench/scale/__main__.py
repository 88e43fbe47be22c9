"""``python -m tests.bench.scale``: what a fleet of so many vehicles costs, by real routers on this machine."""

from __future__ import annotations

import click
import msgspec

from tests.bench.scale.report import report
from tests.bench.scale.simulate import simulate
from tests.bench.scale.study import Run, Shape
from tests.bench.scale.topology import TOPOLOGIES, Topology
from zmav.cli.common import console
from zmav.errors import BadInput

VEHICLES_PER_ROUTER = 10
MOST_ROUTERS = 10
"""by themselves: each is a process, and more of them than cores measure the machine and not the fleet"""


@click.command()
@click.argument("vehicles", type=click.IntRange(1, 5000), nargs=-1, required=True)
@click.option(
    "--routers", type=click.IntRange(1, 200), help="Processes with vehicles.  [default: 1 for 10, at most 10]"
)
@click.option("--topology", type=click.Choice(TOPOLOGIES), default="tree", show_default=True)
@click.option("--groups", type=click.IntRange(0, 100), default=0, help="Also as so many groups with a gateway each.")
@click.option("--seconds", type=click.FloatRange(1.0, 600.0), default=5.0, show_default=True, help="For each phase.")
@click.option("--json", "as_json", is_flag=True, help="One run a line, for scripts.")
def command(
    vehicles: tuple[int, ...], routers: int | None, topology: Topology, groups: int, seconds: float, as_json: bool
) -> None:
    """Measure a fleet that exists only in part: 'python -m tests.bench.scale 10 30 100 --groups 5'.

    Routers are real processes, linked over UDP on loopback; vehicles are what 'zmav up' declares and says, without an
    autopilot. One link, the ground station's, is counted byte by byte. Several numbers give costs a vehicle, fitted.
    """
    runs: list[Run] = []
    for number in vehicles:
        for split in (0, groups) if groups else (0,):
            count = routers or min(max(number // VEHICLES_PER_ROUTER, 2), MOST_ROUTERS)
            if split > number:
                text = f"{split} groups of {number} vehicles"
                raise BadInput(text, field="groups", value=split, expected=f"at most {number}")
            shape = Shape(vehicles=number, routers=max(count, split), topology=topology, groups=split, seconds=seconds)
            run = simulate(shape)
            runs.append(run)
            if as_json:
                click.echo(msgspec.json.encode(run).decode())
            else:
                click.echo(said(run), err=True)
    if not as_json:
        out = console()
        out.width = max(out.width, 180)  # a table is read whole or not at all
        out.print(report(runs))


def said(run: Run) -> str:
    """A line while one waits for the next run."""
    groups = f" in {run.shape.groups} groups" if run.shape.groups else ""
    return f"{run.shape.vehicles} vehicles behind {run.shape.routers} routers{groups}: formed in {run.form:.1f} s"


if __name__ == "__main__":
    command()
