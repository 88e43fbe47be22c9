"""``zmav echo``: what goes over the keys, decoded."""

from __future__ import annotations

import asyncio
import itertools
import time
from typing import Any

import click
import zenoh

from zmav import keys
from zmav.cli.common import Finite, Work, connected, dialect_option, dump, json_option, tell
from zmav.client import Client
from zmav.errors import NoSuchVehicle, ZmavError
from zmav.mavlink import Dialect
from zmav.process import say
from zmav.vehicle import Vehicle
from zmav.vehicle.rates import want_key
from zmav.waiting import within
from zmav.zenoh_codec import readable

VEHICLES_OWN = {channel.path.partition("/")[0] for channel in keys.VEHICLES_OWN}
SILENT_S = 3.0
"""s without anything, after which it is looked into why"""


@click.command("echo")
@click.argument("key")
@click.option("-n", "--count", type=click.IntRange(1), help="End after that many.")
@click.option(
    "--rate", "hz", type=Finite(), help="Have the autopilot send the message so many times a second meanwhile."
)
@dialect_option
@json_option
@connected
def command(key: str, count: int | None, hz: float | None, as_json: bool) -> Work:
    """Print what is published: 'quad1' (its state), 'quad*/ATTITUDE', 'quad1/link/*', or any key expression.

    A message that the autopilot does not send by itself is asked for as long as it is read, a few times a second or as
    fast as --rate says: 'zmav echo quad1/VFR_HUD --rate 20'.
    """

    async def echo(z: Client) -> None:
        token = "" if hz is None else want_key(keys.expression(key, z.fleet_name), hz, "echo")
        async with z.subscribe(key, token=token) as samples:
            await asyncio.to_thread(lambda: z.dialect)  # an unknown one is said now, and not at every message
            try:
                sample = await within(SILENT_S, samples.get())
            except asyncio.TimeoutError:
                say(await why_silent(z, keys.expression(key, z.fleet_name)))
                sample = await samples.get()
            for seen in itertools.count(1):
                document = document_of(sample, z.dialect)
                tell(as_json, document, text_of(document))
                if seen == count:
                    return
                sample = await samples.get()

    return echo


async def why_silent(z: Client, expression: str) -> str:
    """What there is instead of what nobody publishes now. Raises :class:`NoSuchVehicle` where the vehicle is not there,
    and :class:`~zmav.errors.BadMessage` for a message that the dialect has not.
    """
    chunks = expression.split("/")
    what = "/".join(chunks[3:])
    silent = f"nothing comes on {expression} yet"
    if chunks[0] != keys.ROOT or what.partition("/")[0] not in VEHICLES_OWN:
        return f"{silent}; Ctrl-C ends this"
    known = await z.settle()
    meant = [v for v in known if _meets(keys.STATE.key(v.fleet, v.name), "/".join([*chunks[:3], "state"]))]
    if not meant:
        present = ", ".join(sorted(v.name for v in known)) or "nobody"
        raise NoSuchVehicle(f"no vehicle {chunks[2]} is heard in the fleet {chunks[1]} (present: {present})")
    name = chunks[-1]
    if len(chunks) == 8 and keys.MESSAGE.match(name) and not name.startswith("UNKNOWN_"):
        z.dialect.message(name)
        return f"{silent}: {await _sent_by(meant[0])}; Ctrl-C ends this"
    return f"{silent}; Ctrl-C ends this"


def _meets(key: str, expression: str) -> bool:
    return zenoh.KeyExpr(expression).intersects(zenoh.KeyExpr(key))


async def _sent_by(vehicle: Vehicle) -> str:
    try:
        table = await vehicle.rates.table()
    except ZmavError as e:
        return f"{vehicle.name} does not say what its autopilot sends ({e})"
    names = sorted({each.name for each in table.messages if each.hz > 0.0})
    return f"{vehicle.name}'s autopilot sends {', '.join(names) or 'nothing'}"


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
    return value if isinstance(value, str) else dump(value)
