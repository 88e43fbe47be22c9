"""``zmav do``: give an order to vehicles."""

from __future__ import annotations

import asyncio
from typing import Any

import click

from zmav import wire
from zmav.cli.common import Work, assignments, connected, dump, json_option
from zmav.cli.progress import Progress
from zmav.cli.vehicles import matching
from zmav.client import Client
from zmav.process import say
from zmav.swarm import FleetOrder, VehicleProgress
from zmav.verbs import VERBS, Access


@click.command("do")
@click.argument("vehicles")
@click.argument("verb", type=click.Choice(sorted(VERBS)))
@click.argument("arguments", nargs=-1, metavar="[NAME=VALUE]...")
@json_option
@connected
def command(vehicles: str, verb: str, arguments: tuple[str, ...], as_json: bool) -> Work:
    """Give an order: 'zmav do quad1 arm', 'zmav do quad1 takeoff alt_rel=10', 'zmav do "quad*" land'."""
    return order(vehicles, verb, assignments(arguments), as_json)


def order(vehicles: str, verb: str, arguments: dict[str, Any], as_json: bool) -> Work:
    """Give the order to all that match, at once, and tell how each ended; ends with an error if any of them refused."""
    args = wire.build(arguments, VERBS[verb].args, verb)

    async def give(z: Client) -> None:
        over = set[str]()
        with Progress(verb, quiet=as_json) as progress:

            def tell(news: str | VehicleProgress) -> None:
                progress.clear()
                if isinstance(news, str):
                    click.echo(news, err=True)
                elif news.status != "running":
                    over.add(news.vehicle)
                    click.echo(dump(_document(news)) if as_json else _words(news, verb))

            targets = await matching(z, vehicles)
            order = FleetOrder(z, targets, verb, args, tell, lambda v: lambda n: progress.tell(v.name, n))
            try:
                ended = await order.run()
            except asyncio.CancelledError:
                progress.clear()
                if left := [v.name for v in targets if v.name not in over]:
                    say(_goes_on(vehicles, left, verb))
                raise
        if any(told.status == "failed" for told in ended):
            raise SystemExit(1)

    return give


def _goes_on(vehicles: str, names: list[str], verb: str) -> str:
    """What becomes of an order when the one who waits for it is interrupted: the vehicle has it, and does it."""
    whom = f"'{vehicles}'" if any(c in vehicles for c in "*?[") else vehicles
    stop = f". To stop there: zmav do {whom} hold" if VERBS[verb].access in (Access.MOVE, Access.OPEN) else ""
    goes = "goes" if len(names) == 1 else "go"
    return f"only the waiting has ended: {', '.join(names)} {goes} on with {verb}{stop}"


def _document(told: VehicleProgress) -> dict[str, Any]:
    if told.status == "failed":
        return {"vehicle": told.vehicle, "error": told.error, "message": told.text}
    if told.status == "left_out":
        return {"vehicle": told.vehicle, "left_out": told.text}
    return {"vehicle": told.vehicle, "result": told.result}


def _words(told: VehicleProgress, verb: str) -> str:
    if told.status == "failed":
        return f"{told.vehicle}: {verb} not done: {told.text}"
    details = ", ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in told.result.items())
    return f"{told.vehicle}: {verb} {told.text}" + (f" ({details})" if details else "")
