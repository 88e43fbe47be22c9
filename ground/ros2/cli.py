"""``zmav ros2``."""

from __future__ import annotations

import asyncio
import os

import click
import msgspec

from zmav import keys, systemd
from zmav.cli import installed
from zmav.cli.common import dialect_option, run, zenoh_options
from zmav.client import Client, connect
from zmav.config import load_fleet
from zmav.config.fleet import Ros2
from zmav.errors import BadConfig, Forbidden, needs
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials
from zmav.waiting import until_any

DOMAIN = "ROS_DOMAIN_ID"
LARGEST_DOMAIN = 232
FED = 1.0
"""s between two signs of life that systemd gets"""


class Settings(msgspec.Struct, frozen=True):
    """What is shown, and what it may do."""

    fleet: str
    domain: int
    rates: dict[str, float]
    orders: bool
    only: str | None
    """one vehicle's name; None: all, and the swarm"""


@click.command("ros2")
@click.option(
    "--domain",
    type=click.IntRange(0, LARGEST_DOMAIN),
    envvar=DOMAIN,
    show_envvar=True,
    help="The domain of ROS.  [default: the fleet file's, or 0]",
)
@click.option("--rate", multiple=True, metavar="TOPIC=HZ", help="Have a topic come so fast: imu/data=50 (repeatable).")
@click.option("--orders", is_flag=True, help="Take orders, setpoints and parameters from ROS: any node may give them.")
@click.option("--file", "fleet_file", metavar="FILE", help="Fleet file (TOML), for its name and its [ros2].")
@click.option(
    "--beside",
    is_flag=False,
    flag_value="",
    metavar="[VEHICLE]",
    help="Show one vehicle, as the fleet file's [ros2] says; without a name that of this computer's service.",
)
@click.option("--fleet", help="The fleet's name.  [default: the fleet file's, or demo, or $ZMAV_FLEET]")
@dialect_option
@zenoh_options
def command(
    domain: int | None,
    rate: tuple[str, ...],
    orders: bool,
    fleet_file: str | None,
    beside: str | None,
    fleet: str | None,
    dialect: str,
    settings: SessionSettings,
) -> None:
    """Show every vehicle as a node of ROS 2, where ROS uses rmw_zenoh; no ROS needs to be installed here.

    'ros2 topic list' then has /quad1/imu/data, /quad1/state and more, under MAVROS's names. ROS's own programs find
    this host's router at tcp/localhost:7447 as they would find rmw_zenohd. Without --orders nothing that ROS says
    moves or changes a vehicle.
    """
    file = load_fleet(fleet_file) if fleet_file else None
    asked = file.ros2 if file else Ros2()
    if beside is not None:
        if file is None:
            raise BadConfig("--beside needs --file, which says what runs beside it", field="file", expected="a file")
        beside = beside or installed.vehicle_here("--beside VEHICLE")
        if beside not in asked.beside:
            why = f"{fleet_file} has no 'zmav ros2' run beside {beside} ([ros2] beside): there is nothing to do"
            say(why)
            systemd.notify("READY=1", f"STATUS={why}")  # or its end were a failure
            return
    needs("'zmav ros2'", "ros2", "rosbags", "xxhash")
    from ground.ros2.telemetry import rates

    told = tuple(f"{topic}={hz}" for topic, hz in asked.rates.items()) if beside is not None else ()
    if domain is not None and asked.domain not in (None, domain):
        say(f"domain {domain}: {fleet_file} has {asked.domain}, and routers with credentials let no other through")
    own = Credentials.load(settings.credentials) if settings.credentials else None
    shown = Settings(
        fleet=fleet or (own.fleet if own else None) or (file.fleet if file else os.environ.get("ZMAV_FLEET", "demo")),
        domain=domain if domain is not None else asked.domain or 0,
        rates=rates((*told, *rate)),
        orders=orders or (beside is not None and asked.orders),
        only=beside,
    )
    if shown.fleet == "*":
        text = "in ROS a vehicle is found by its name alone: name one fleet with --fleet"
        raise BadConfig(text, field="fleet", value="*", expected="one fleet")
    run(_serve(shown, settings, dialect))


async def _serve(shown: Settings, settings: SessionSettings, dialect: str) -> None:
    from ground.ros2.face import Face

    async with connect(fleet=shown.fleet, settings=settings, dialect=dialect) as z:
        orders = shown.orders and may_order(z, shown.only or "vehicles")
        async with Face(z, shown.domain, shown.rates, say, may_order=orders, only=shown.only) as face:
            how = "with orders from any node of ROS" if orders else "read-only"
            who = f"{shown.fleet}/{shown.only}" if shown.only else f"fleet {shown.fleet}"
            line = f"{who} in ROS domain {shown.domain}, {how}"

            async def tell() -> None:
                say(line)
                systemd.notify("READY=1", f"STATUS={line}")
                while True:
                    systemd.notify("WATCHDOG=1")
                    await asyncio.sleep(FED)

            await until_any(until_stopped(), face.serve(), tell())  # in this order: who reads the line may end us
            systemd.notify("STOPPING=1")


def may_order(z: Client, vehicle: str = "vehicles") -> bool:
    """Whether ROS may give orders: not to recordings, nor with a viewer's credentials, whose orders are refused."""
    if keys.is_replay(z.fleet_name):
        say(f"no orders: {z.fleet_name} is of recordings, which take none")
        return False
    try:
        if z.member is not None:
            z.member.check_role(keys.DO.key(z.member.credentials.fleet, vehicle, verb="arm"))
    except Forbidden as e:
        say(f"no orders, by your credentials: {e}")
        return False
    return True
