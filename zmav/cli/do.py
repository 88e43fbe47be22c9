"""``zmav do``: give an order to vehicles."""

from __future__ import annotations

import asyncio
import fnmatch
from typing import Any

import click
import msgspec

import zmav
from zmav import wire
from zmav.cli.common import assignments, dump, fleet_option, json_option, run, zenoh_options
from zmav.client import Client
from zmav.errors import BadInput, NoSuchVehicle, ZmavError
from zmav.session import SessionSettings
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
    """Give the order to all that match, at once; ends with an error if any of them refused."""
    args = wire.decode(msgspec.json.encode(arguments), VERBS[verb].args, verb)
    async with zmav.open(fleet=fleet, settings=settings) as z:
        targets = await matching(z, vehicles)
        results = await asyncio.gather(*(v.order(verb, args) for v in targets), return_exceptions=True)
    failed: list[ZmavError] = []
    for vehicle, result in zip(targets, results, strict=True):
        if isinstance(result, ZmavError):
            failed.append(result)
            line: dict[str, Any] = {"vehicle": vehicle.name, "error": result.code, "message": result.message}
        elif isinstance(result, BaseException):
            raise result
        else:
            line = {"vehicle": vehicle.name, "result": result}
        click.echo(dump(line, pretty=False) if as_json else _say(line, verb))
    if failed:
        raise SystemExit(1)


def _say(line: dict[str, Any], verb: str) -> str:
    if "error" in line:
        return f"{line['vehicle']}: {verb} not done: {line['message']}"
    details = ", ".join(f"{k} {v:.2f}" if isinstance(v, float) else f"{k} {v}" for k, v in line["result"].items())
    return f"{line['vehicle']}: {verb} done" + (f" ({details})" if details else "")


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
