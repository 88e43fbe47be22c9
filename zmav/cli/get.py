"""``zmav get``: ask the key space."""

from __future__ import annotations

import json

import click

from zmav import keys
from zmav.cli.common import Between, Work, connected, dump, json_option, tell
from zmav.client import Answer, Client
from zmav.errors import NoSuchVehicle, ZmavError


@click.command("get")
@click.argument("key")
@click.option("--value", default="", help="JSON to send with the query.")
@click.option("--timeout", type=Between(min=0.1), default=3.0, show_default=True, help="Seconds to wait.")
@json_option
@connected
def command(key: str, value: str, timeout: float, as_json: bool) -> Work:
    """Query a key expression: 'zmav get quad1/msg/ATTITUDE', 'zmav get quad1', 'zmav get "@/*/router"'."""

    async def ask(z: Client) -> None:
        expression = keys.expression(key, z.fleet_name)
        answers = await z.ask(expression, value.encode(), timeout)
        if not answers:
            raise NoSuchVehicle(
                f"nobody answers on {expression}: 'zmav ls' shows who is there; vehicles answer on state, msg/NAME, "
                "do/VERB"
            )
        for answer in sorted(answers, key=lambda each: isinstance(each, ZmavError)):
            if isinstance(answer, ZmavError):
                raise answer
            _show(answer, as_json)

    return ask


def _show(answer: Answer, as_json: bool) -> None:
    try:
        value = json.loads(answer.payload)
    except (ValueError, RecursionError):
        value = {"hex": answer.payload.hex()}
    text = f"{click.style(answer.key, bold=True)}\n{dump(value, pretty=True)}"
    tell(as_json, {"key": answer.key, "value": value}, text)
