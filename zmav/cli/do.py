"""``zmav do``: give an order to vehicles."""

from __future__ import annotations

import fnmatch
from typing import Any

import click
import msgspec

import zmav
from zmav import wire
from zmav.cli.common import assignments, dump, fleet_option, json_option, run, zenoh_options
from zmav.cli.progress import Progress
from zmav.client import Client
from zmav.errors import BadInput, NoSuchVehicle
from zmav.session import SessionSettings
from zmav.swarm import FleetOrder, VehicleProgress
from zmav.verbs import VERBS


@click.command("do")
@click.argument("vehicles")
@click.argument("verb", type=click.Choice(sorted(VERBS)))
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]...")
@fleet_option
@json_option
@zenoh_options
def command(
    vehicles: str, verb: str, arguments: tuple[str, ...], fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Give an order: 'zmav do quad1 arm', 'zmav do quad1 takeoff alt_rel=10', 'zmav do "quad*" land'."""
    run(give(vehicles, verb, assignments(arguments), fleet, as_json, settings))


async def give(
    vehicles: str, verb: str, arguments: dict[str, Any], fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Give the order to all that match, at once, and tell how each ended; ends with an error if any of them refused."""
    args = wire.decode(msgspec.json.encode(arguments), VERBS[verb].args, verb)

    def tell(news: str | VehicleProgress) -> None:
        if isinstance(news, str):
            click.echo(news, err=True)
        elif news.status != "running":
            click.echo(dump(_document(news), pretty=False) if as_json else _say(news, verb))

    async with zmav.open(fleet=fleet, settings=settings) as z:
        progress = (lambda vehicle: None) if as_json else (lambda vehicle: Progress(vehicle.name, verb))
        ended = await FleetOrder(z, await matching(z, vehicles), verb, args, tell, progress).run()
    if any(told.status == "failed" for told in ended):
        raise SystemExit(1)


def _document(told: VehicleProgress) -> dict[str, Any]:
    if told.status == "failed":
        return {"vehicle": told.vehicle, "error": told.error, "message": told.text}
    if told.status == "left_out":
        return {"vehicle": told.vehicle, "left_out": told.text}
    return {"vehicle": told.vehicle, "result": told.result}


def _say(told: VehicleProgress, verb: str) -> str:
    if told.status == "failed":
        return f"{told.vehicle}: {verb} not done: {told.text}"
    details = ", ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in told.result.items())
    return f"{told.vehicle}: {verb} {told.text}" + (f" ({details})" if details else "")


async def matching(z: Client, pattern: str) -> list[zmav.Vehicle]:
    """The vehicles a name or shell pattern means; raises :class:`NoSuchVehicle` naming those present."""
    if not any(c in pattern for c in "*?["):
        if not pattern:
            raise BadInput("no vehicle is named", field="vehicles", value=pattern, expected="a name or a pattern")
        return await z.wait_for(pattern, timeout=5.0)
    known = await z.settle()
    found = [v for v in known if fnmatch.fnmatchcase(v.name, pattern)]
    if not found:
        present = ", ".join(v.name for v in known) or "nobody"
        raise NoSuchVehicle(f"no vehicle matches {pattern!r}; present: {present}")
    return found
