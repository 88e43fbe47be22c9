"""``zmav echo``: what goes over the keys, decoded."""

from __future__ import annotations

import json
import time
from typing import Any

import click
import msgspec
import zenoh

import zmav
from zmav import keys
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
from zmav.client import Client
from zmav.errors import BadInput
from zmav.mavlink import describe, parse_frame
from zmav.session import SessionSettings


@click.command("echo")
@click.argument("key")
@click.option("-n", "--count", type=int, help="End after that many.")
@click.option("--dialect", default="ardupilotmega", show_default=True, help="common, development, or an XML file.")
@fleet_option
@json_option
@zenoh_options
def command(key: str, count: int | None, dialect: str, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Print what is published: 'quad1' (its state), 'quad*/ATTITUDE', 'quad1/link/*', or any key expression."""
    run(_echo(key, count, dialect, fleet, as_json, settings))


async def _echo(
    key: str, count: int | None, dialect: str, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings, dialect=dialect) as z, z.subscribe(key) as samples:
        seen = 0
        async for sample in samples:
            document = document_of(z, sample)
            click.echo(dump(document, pretty=False) if as_json else text_of(document))
            seen += 1
            if seen == count:
                return


def document_of(z: Client, sample: zenoh.Sample) -> dict[str, Any]:
    """A sample as a JSON document: a frame decoded, JSON as it is, anything else as hexadecimal digits."""
    key, payload = str(sample.key_expr), sample.payload.to_bytes()
    document: dict[str, Any] = {"t": time.time(), "key": key}
    if str(sample.kind).endswith("DELETE"):
        return {**document, "deleted": True}
    try:
        channel = keys.match(key)[0].name
        if channel in ("rx", "tx"):
            return {**document, "message": msgspec.to_builtins(describe(parse_frame(payload, z.dialect), z.dialect))}
    except BadInput as e:
        document["error"] = str(e)
    try:
        return {**document, "value": json.loads(payload)}
    except ValueError:
        return {**document, "hex": payload.hex()}


def text_of(document: dict[str, Any]) -> str:
    """The same for a person: the key, then a line a field with its unit."""
    head = click.style(document["key"], bold=True)
    if "message" in document:
        m = document["message"]
        unit = m["units"]
        lines = [f"  {k}: {_number(v)}{' ' + unit[k] if unit.get(k) else ''}" for k, v in m["fields"].items()]
        return "\n".join([f"{head}  ({m['sysid']}/{m['compid']} seq {m['seq']})", *lines])
    rest = {k: v for k, v in document.items() if k not in ("key", "t")}
    body = rest.get("value", rest)
    if isinstance(body, dict):
        return "\n".join([head, *(f"  {k}: {_number(v)}" for k, v in body.items())])
    return f"{head}\n  {body}"


def _number(value: Any) -> str:
    return f"{value:.7g}" if isinstance(value, float) and abs(value) < 1e9 else str(value)
