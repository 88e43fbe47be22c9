"""``zmav ros2``."""

from __future__ import annotations

import asyncio

import click

from zmav import keys
from zmav.cli.common import Work, connected, dialect_option
from zmav.client import Client
from zmav.errors import BadConfig, Forbidden, missing_extra
from zmav.process import leave, say, until_stopped

DOMAIN = "ROS_DOMAIN_ID"
LARGEST_DOMAIN = 232


@click.command("ros2")
@click.option(
    "--domain",
    type=click.IntRange(0, LARGEST_DOMAIN),
    default=0,
    show_default=True,
    envvar=DOMAIN,
    show_envvar=True,
    help="The domain of ROS.",
)
@click.option("--rate", multiple=True, metavar="TOPIC=HZ", help="Have a topic come so fast: imu/data=50 (repeatable).")
@click.option("--orders", is_flag=True, help="Take orders, setpoints and parameters from ROS: any node may give them.")
@dialect_option
@connected
def command(domain: int, rate: tuple[str, ...], orders: bool) -> Work:
    """Show every vehicle as a node of ROS 2, where ROS uses rmw_zenoh; no ROS needs to be installed here.

    'ros2 topic list' then has /quad1/imu/data, /quad1/state and more, under MAVROS's names. ROS's own programs find
    this host's router at tcp/localhost:7447 as they would find rmw_zenohd. Without --orders nothing that ROS says
    moves or changes a vehicle.
    """
    try:
        import rosbags  # noqa: F401
        import xxhash  # noqa: F401
    except ImportError as e:
        raise missing_extra("'zmav ros2'", e.name, "ros2") from e
    from ground.ros2.telemetry import rates

    wanted = rates(rate)
    return lambda z: _serve(z, domain, wanted, orders)


async def _serve(z: Client, domain: int, wanted: dict[str, float], orders: bool) -> None:
    from ground.ros2.face import Face

    if z.fleet_name == "*":
        text = "in ROS a vehicle is found by its name alone: name one fleet with --fleet"
        raise BadConfig(text, field="fleet", value="*", expected="one fleet")
    orders = orders and may_order(z)
    async with Face(z, domain, wanted, say, may_order=orders):
        stopped = asyncio.ensure_future(until_stopped())
        await asyncio.sleep(0)  # who reads the line may end us at once
        how = "with orders from any node of ROS" if orders else "read-only"
        say(f"fleet {z.fleet_name} in ROS domain {domain}, {how}")
        await stopped
    leave()


def may_order(z: Client) -> bool:
    """Whether ROS may give orders: not to recordings, nor with a viewer's credentials, whose orders are refused."""
    if keys.is_replay(z.fleet_name):
        say(f"no orders: {z.fleet_name} is of recordings, which take none")
        return False
    try:
        if z.member is not None:
            z.member.check_role(keys.DO.key(z.member.credentials.fleet, "vehicles", verb="arm"))
    except Forbidden as e:
        say(f"no orders, by your credentials: {e}")
        return False
    return True
