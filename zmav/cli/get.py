"""``zmav get``: ask the key space."""

from __future__ import annotations

import json

import click

import zmav
from zmav import keys
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
from zmav.client import Answer
from zmav.errors import NoSuchVehicle, ZmavError
from zmav.session import SessionSettings


@click.command("get")
@click.argument("key")
@click.option("--value", default="", help="JSON to send with the query.")
@click.option("--timeout", type=click.FloatRange(min=0.1), default=3.0, show_default=True, help="Seconds to wait.")
@fleet_option
@json_option
@zenoh_options
def command(key: str, value: str, timeout: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Query a key expression: 'zmav get quad1/msg/ATTITUDE', 'zmav get quad1', 'zmav get "@/*/router"'."""
    run(_get(key, value, timeout, fleet, as_json, settings))


async def _get(key: str, value: str, timeout: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    expression = keys.expression(key, fleet)
    async with zmav.open(fleet=fleet, settings=settings) as z:
        answers = await z.ask(expression, value.encode(), timeout)
    if not answers:
        raise NoSuchVehicle(
            f"nobody answers on {expression}: 'zmav ls' shows who is there; vehicles answer on state, msg/NAME, do/VERB"
        )
    for answer in answers:
        if isinstance(answer, Answer):
            _show(answer, as_json)
    for answer in answers:
        if isinstance(answer, ZmavError):
            raise answer


def _show(answer: Answer, as_json: bool) -> None:
    try:
        value = json.loads(answer.payload)
    except (ValueError, RecursionError):
        value = {"hex": answer.payload.hex()}
    if as_json:
        click.echo(dump({"key": answer.key, "value": value}, pretty=False))
    else:
        click.echo(click.style(answer.key, bold=True))
        click.echo(dump(value, pretty=True))
