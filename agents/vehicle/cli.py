"""``zmav up``: the one agent dropped on each vehicle: a router, the adapter and the services beside the autopilot."""

from __future__ import annotations

import asyncio
import contextlib

import click
import msgspec
import zenoh

from zmav import keys, wire
from zmav.cli.common import listening, run, zenoh_options
from zmav.config import FleetConfig, Signing, load_fleet, origin_of
from zmav.errors import BadConfig, BadInput
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import until_stopped
from zmav.session import SessionSettings, open_session


@click.command("up")
@click.option(
    "--link", help="The autopilot: /dev/ttyACM0, /dev/ttyUSB0,57600, udpin:HOST:PORT, tcp:HOST:PORT, replay:FILE."
)
@click.option("--name", default="quad1", show_default=True, help="The vehicle's name in the fleet.")
@click.option("--fleet", help="The fleet's name.  [default: demo, or the fleet file's]")
@click.option("--file", "fleet_file", metavar="FILE", help="Fleet file (TOML) with this vehicle's table.")
@click.option(
    "--sysid", type=click.IntRange(1, 255), help="Which MAVLink system is the vehicle.  [default: the first autopilot]"
)
@click.option("--dialect", help="common, development, or an XML file.  [default: ardupilotmega]")
@click.option("--origin", type=float, nargs=3, metavar="LAT LON AMSL", help="The fleet's origin, for local frames.")
@click.option("--signing-key", metavar="FILE", help="Sign, and take only what is signed, with the key in this file.")
@click.option("--cache", metavar="DIR", help="Where fetched files and logs are kept.  [default: the user's cache]")
@zenoh_options
def up(
    link: str | None, name: str, fleet: str | None, fleet_file: str | None, sysid: int | None, dialect: str | None,
    origin: tuple[float, float, float] | None, signing_key: str | None, cache: str | None,
    settings: SessionSettings,
) -> None:  # fmt: skip
    """Run beside an autopilot: 'zmav up --link /dev/ttyACM0 --name quad1'.

    Opens a Zenoh router (on loopback unless -l says otherwise) and puts the vehicle on the key space. An autopilot that
    comes late, goes away or is exchanged is waited for. SIGTERM ends it cleanly.
    """
    file = load_fleet(fleet_file) if fleet_file else FleetConfig()
    table = file.vehicle(name) if fleet_file else None
    url = link or (table.link if table else None)
    if url is None:
        raise BadConfig("give --link, or --file with this vehicle's table", field="link", value=None, expected="a URL")
    vehicle = OnboardSettings(
        link=url,
        name=name,
        fleet=fleet or file.fleet,
        sysid=sysid if sysid is not None else (table.sysid if table else None),
        dialect=dialect or (table.dialect if table else "ardupilotmega"),
        origin=origin_of(*origin) if origin else file.origin,
        failsafe=(table.failsafe if table else None) or file.failsafe,
        geofence=(table.geofence if table else None) or file.geofence,
        limits=(table.limits if table else None) or file.limits,
        pilot_switch=table.pilot_switch if table else None,
        cache=cache,
        signing=Signing(key_file=signing_key) if signing_key else (table.signing if table else None),
    )
    settings = listening(settings, table.listen if table else ())
    run(_up(vehicle, msgspec.structs.replace(settings, connect=settings.connect or (table.connect if table else ()))))


async def _up(vehicle: OnboardSettings, settings: SessionSettings) -> None:
    with await asyncio.to_thread(open_session, settings) as session:
        onboard = Onboard(session, vehicle)
        session.declare_subscriber(keys.EVENT.key(vehicle.fleet, vehicle.name), _log)
        async with onboard:
            click.echo(f"{vehicle.fleet}/{vehicle.name}: {vehicle.link} on {' '.join(settings.listen)}", err=True)
            await until_stopped()


def _log(sample: zenoh.Sample) -> None:
    """An event as a line of the process's log: what happens to the link and the autopilot, and what was refused."""
    with contextlib.suppress(BadInput):  # somebody else's: ours are what they should be
        event = wire.decode(sample.payload.to_bytes(), wire.Event, "event")
        click.echo(f"{event.severity}: {event.text}", err=True)
