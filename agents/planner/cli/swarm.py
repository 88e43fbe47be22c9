"""``zmav swarm``: orders for several vehicles at once, planned together."""

from __future__ import annotations

import click
import msgspec

import zmav
from agents.planner.cli import agent, goals, orders
from agents.planner.swap import swap
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
from zmav.errors import BadInput
from zmav.session import SessionSettings


@click.group("swarm")
def swarm() -> None:
    """Move several vehicles at once, planned together.

    'zmav swarm planner' runs the planner; the other verbs find it and tell it what to do. Places are metres north and
    east of the fleet's origin and above it: 30,-5,15.
    """


swarm.add_command(agent.planner)
for each in (*goals.COMMANDS, *orders.COMMANDS):
    swarm.add_command(each)


@swarm.command("swap")
@click.argument("vehicles", nargs=-1, required=True)
@click.option("--node", default="ground", show_default=True, help="Name of the host the planner runs on.")
@fleet_option
@json_option
@zenoh_options
def swap_command(vehicles: tuple[str, ...], node: str, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Take off, change places in a ring at separate heights, land: 'zmav swarm swap quad1 quad2 quad3'."""
    if len(set(vehicles)) < 2:
        raise BadInput(
            "a swap needs two vehicles or more", field="vehicles", value=list(vehicles), expected="two names"
        )
    run(_swap(tuple(dict.fromkeys(vehicles)), node, fleet, as_json, settings))


async def _swap(vehicles: tuple[str, ...], node: str, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        flown = await swap(z, vehicles, node, lambda text: click.echo(text, err=True))
    for name, part in flown.items():
        away = "-" if part.away is None else f"{part.away:.2f} m from its goal"
        line = {"vehicle": name, **msgspec.to_builtins(part)}
        click.echo(
            dump(line, pretty=False) if as_json else f"{name}: {'arrived' if part.arrived else 'FAILED'}, {away}"
        )
    if not all(part.arrived for part in flown.values()):
        raise SystemExit(1)
