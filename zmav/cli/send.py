"""``zmav send``: put one MAVLink message to a vehicle."""

from __future__ import annotations

import asyncio
import contextlib

import click

from zmav import keys, wire
from zmav.cli.common import Work, assignments, connected, dialect_option
from zmav.cli.vehicles import matching
from zmav.client import Client
from zmav.errors import Stale
from zmav.mavlink import encode
from zmav.subscription import Subscription
from zmav.waiting import within

REFUSAL_S = 0.3
"""s for a refusal to come as an event: a put has no answer"""


@click.command("send")
@click.argument("vehicles")
@click.argument("message")
@click.argument("fields", nargs=-1, metavar="[FIELD=VALUE]...")
@click.option("--sysid", type=click.IntRange(1, 255), default=255, show_default=True, help="System id to speak as.")
@click.option("--compid", type=click.IntRange(1, 255), default=190, show_default=True, help="Component id to speak as.")
@dialect_option
@connected
def command(vehicles: str, message: str, fields: tuple[str, ...], sysid: int, compid: int) -> Work:
    """Send a message, every field given: 'zmav send quad1 SET_MODE base_mode=1 custom_mode=4'.

    target_system and target_component are the vehicle's own unless given. A frame meant for another is refused.
    """
    values = assignments(fields)

    async def send(z: Client) -> None:
        known = {field.name for field in z.dialect.message(message).fields}
        for vehicle in await matching(z, vehicles):
            state = vehicle.state
            if state.sysid is None or state.compid is None:
                raise Stale(f"{vehicle.name} has no autopilot yet", vehicle=vehicle.name)
            target = {"target_system": state.sysid, "target_component": state.compid}
            full = {**{k: v for k, v in target.items() if k in known}, **values}
            frame = encode(z.dialect, message, full, sysid=sysid, compid=compid)
            key = keys.TX.key(state.fleet, vehicle.name, sys=state.sysid, comp=state.compid, msg=message)
            async with vehicle.events() as events:
                z.put(keys.TX, key, frame)
                click.echo(f"{vehicle.name}: {message} sent ({len(frame)} bytes)")
                with contextlib.suppress(asyncio.TimeoutError):
                    click.echo(f"{vehicle.name}: {await within(REFUSAL_S, _refusal(events))}", err=True)
                    raise SystemExit(1)

    return send


async def _refusal(events: Subscription[wire.Event]) -> str:
    while (event := await events.get()).kind != "refused":
        pass
    return event.text
