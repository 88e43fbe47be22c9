"""``zmav echo``: what goes over the keys, decoded."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import click
import zenoh

import zmav
from zmav import keys
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
from zmav.mavlink import Dialect
from zmav.session import SessionSettings
from zmav.vehicle.rates import want_key
from zmav.zenoh_codec import readable


@click.command("echo")
@click.argument("key")
@click.option("-n", "--count", type=click.IntRange(1), help="End after that many.")
@click.option("--rate", "hz", type=float, help="Have the autopilot send the message so many times a second meanwhile.")
@click.option(
    "--dialect", default="ardupilotmega", show_default=True, help="common, development, or another of pymavlink."
)
@fleet_option
@json_option
@zenoh_options
def command(
    key: str, count: int | None, hz: float | None, dialect: str, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Print what is published: 'quad1' (its state), 'quad*/ATTITUDE', 'quad1/link/*', or any key expression.

    A message that the autopilot does not send by itself is asked for as long as it is read, a few times a second or as
    fast as --rate says: 'zmav echo quad1/VFR_HUD --rate 20'.
    """
    run(_echo(key, count, hz, dialect, fleet, as_json, settings))


async def _echo(
    key: str, count: int | None, hz: float | None, dialect: str, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    token = "" if hz is None else want_key(keys.expression(key, fleet), hz, "echo")
    async with (
        zmav.open(fleet=fleet, settings=settings, dialect=dialect) as z,
        z.subscribe(key, token=token) as samples,
    ):
        await asyncio.to_thread(lambda: z.dialect)  # an unknown one is said now, and not at every message
        seen = 0
        async for sample in samples:
            document = document_of(sample, z.dialect)
            click.echo(dump(document, pretty=False) if as_json else text_of(document))
            seen += 1
            if seen == count:
                return


def document_of(sample: zenoh.Sample, dialect: Dialect) -> dict[str, Any]:
    """A sample as a JSON document: when it came, its key, and what it holds."""
    document: dict[str, Any] = {"t": time.time(), "key": str(sample.key_expr)}
    if sample.kind == zenoh.SampleKind.DELETE:
        return {**document, "deleted": True}
    return {**document, **readable(document["key"], sample.payload.to_bytes(), dialect)}


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
    if isinstance(value, float):
        return f"{value:.7g}" if abs(value) < 1e6 else str(value)
    return value if isinstance(value, str) else dump(value, pretty=False)
