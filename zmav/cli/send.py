"""``zmav send``: put one MAVLink message to a vehicle."""

from __future__ import annotations

import asyncio
import contextlib

import click

import zmav
from zmav import keys
from zmav.cli.common import assignments, fleet_option, run, zenoh_options
from zmav.cli.do import matching
from zmav.errors import Stale
from zmav.mavlink import encode
from zmav.session import SessionSettings
from zmav.waiting import within


@click.command("send")
@click.argument("vehicles")
@click.argument("message")
@click.argument("fields", nargs=-1, metavar="[FIELD=VALUE]...")
@click.option("--sysid", type=click.IntRange(1, 255), default=255, show_default=True, help="System id to speak as.")
@click.option("--compid", type=click.IntRange(1, 255), default=190, show_default=True, help="Component id to speak as.")
@click.option("--dialect", default="ardupilotmega", show_default=True)
@fleet_option
@zenoh_options
def command(
    vehicles: str,
    message: str,
    fields: tuple[str, ...],
    sysid: int,
    compid: int,
    dialect: str,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Send a message, every field given: 'zmav send quad1 SET_MODE base_mode=1 custom_mode=4'.

    target_system and target_component are the vehicle's own unless given. A frame meant for another is refused.
    """
    run(_send(vehicles, message, fields, (sysid, compid), dialect, fleet, settings))


async def _send(
    vehicles: str,
    message: str,
    fields: tuple[str, ...],
    source: tuple[int, int],
    dialect: str,
    fleet: str,
    settings: SessionSettings,
) -> None:
    values = assignments(fields)
    async with zmav.open(fleet=fleet, settings=settings, dialect=dialect) as z:
        known = {field.name for field in z.dialect.message(message).fields}
        for vehicle in await matching(z, vehicles):
            state = vehicle.state
            if state.sysid is None or state.compid is None:
                raise Stale(f"{vehicle.name} has no autopilot yet", vehicle=vehicle.name)
            target = {"target_system": state.sysid, "target_component": state.compid}
            full = {**{k: v for k, v in target.items() if k in known}, **values}
            frame = encode(z.dialect, message, full, sysid=source[0], compid=source[1])
            key = keys.TX.key(state.fleet, vehicle.name, sys=state.sysid, comp=state.compid, msg=message)
            async with z.subscribe(keys.EVENT.key(state.fleet, vehicle.name)) as events:
                z.put(keys.TX, key, frame)
                click.echo(f"{vehicle.name}: {message} sent ({len(frame)} bytes)")
                with contextlib.suppress(asyncio.TimeoutError):
                    while True:  # a refusal comes as an event: a put has no answer
                        event = await within(0.3, events.get())
                        told = zmav.wire.decode(event.payload.to_bytes(), zmav.wire.Event, "event")
                        if told.kind == "refused":
                            click.echo(f"{vehicle.name}: {told.text}", err=True)
                            raise SystemExit(1)
