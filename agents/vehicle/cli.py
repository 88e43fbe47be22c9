"""``zmav up``: the one agent dropped on each vehicle: a router, the adapter and the services beside the autopilot."""

from __future__ import annotations

import gc
from functools import partial

import click

from mesh.cli.options import file_option, insecure_option, plan_host
from zmav.cli.common import run, zenoh_options
from zmav.config import Signing, VehicleConfig, origin_of
from zmav.errors import BadConfig
from zmav.mavlink import load_dialect
from zmav.session import SessionSettings


@click.command("up")
@click.option(
    "--link", help="The autopilot: /dev/ttyACM0, /dev/ttyUSB0,57600, udpin:HOST:PORT, tcp:HOST:PORT, replay:FILE."
)
@click.option("--name", default="quad1", show_default=True, help="The vehicle's name in the fleet.")
@click.option("--fleet", help="The fleet's name.  [default: demo, or the fleet file's]")
@file_option
@click.option(
    "--sysid", type=click.IntRange(1, 255), help="Which MAVLink system is the vehicle.  [default: the first autopilot]"
)
@click.option("--dialect", help="common, development, or a module of mavgen.  [default: ardupilotmega]")
@click.option("--origin", type=float, nargs=3, metavar="LAT LON AMSL", help="The fleet's origin, for local frames.")
@click.option("--signing-key", metavar="FILE", help="Sign, and take only what is signed, with the key in this file.")
@click.option("--cache", metavar="DIR", help="Where fetched files and logs are kept.  [default: the user's cache]")
@insecure_option
@zenoh_options
def up(
    link: str | None,
    name: str,
    fleet: str | None,
    fleet_file: str | None,
    sysid: int | None,
    dialect: str | None,
    origin: tuple[float, float, float] | None,
    signing_key: str | None,
    cache: str | None,
    insecure: bool,
    settings: SessionSettings,
) -> None:
    """Run beside an autopilot: 'zmav up --link /dev/ttyACM0 --name quad1'.

    Opens a Zenoh router and puts the vehicle on the key space. The router keeps to loopback unless the fleet file, -l
    or -e say otherwise, and goes beyond it only with --credentials or --insecure ('zmav mesh config' shows what
    results). An autopilot that comes late, goes away or is exchanged is waited for. SIGTERM ends it cleanly.
    """
    plan_again = partial(plan_host, fleet_file, name, settings, fleet=fleet, insecure=insecure, vehicle=True)
    plan = plan_again()
    file = plan.file
    table = file.vehicle(name) if fleet_file else file.filled(VehicleConfig(link=""))
    url = link or table.link
    if not url:
        raise BadConfig("give --link, or --file with this vehicle's table", field="link", value=None, expected="a URL")
    spoken = dialect or table.dialect
    # First, and collected: it takes 6 MB while it is read, which what is imported next uses again.
    load_dialect(spoken)
    gc.collect()
    from agents.vehicle.run import run_vehicle
    from zmav.onboard import OnboardSettings

    vehicle = OnboardSettings(
        link=url,
        name=name,
        fleet=plan.fleet,
        sysid=table.sysid if sysid is None else sysid,
        dialect=spoken,
        origin=origin_of(*origin) if origin else file.origin,
        failsafe=table.failsafe or file.failsafe,
        geofence=table.geofence or file.geofence,
        limits=table.limits or file.limits,
        body=table.body,
        separation=file.separation,
        traffic=file.traffic,
        rights=file.rights,
        pilot_switch=table.pilot_switch,
        streams={camera: table.cameras[camera].uri for camera in table.cameras},
        cache=cache,
        credentials=settings.credentials,
        signing=Signing(key_file=signing_key) if signing_key else table.signing,
    )
    run(run_vehicle(vehicle, plan, settings, plan_again))
