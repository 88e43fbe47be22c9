"""``zmav ros2``."""

from __future__ import annotations

import asyncio

import click

from zmav import keys
from zmav.cli.common import Work, connected, dialect_option
from zmav.client import Client
from zmav.errors import BadConfig, missing_extra
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
@dialect_option
@connected
def command(domain: int, rate: tuple[str, ...]) -> Work:
    """Show every vehicle as a node of ROS 2, where ROS uses rmw_zenoh; no ROS needs to be installed here.

    'ros2 topic list' then has /quad1/imu/data, /quad1/state and more, under MAVROS's names. ROS's own programs find
    this host's router at tcp/localhost:7447 as they would find rmw_zenohd.
    """
    try:
        import rosbags  # noqa: F401
        import xxhash  # noqa: F401
    except ImportError as e:
        raise missing_extra("'zmav ros2'", e.name, "ros2") from e
    from ground.ros2.telemetry import rates

    wanted = rates(rate)
    return lambda z: _serve(z, domain, wanted)


async def _serve(z: Client, domain: int, wanted: dict[str, float]) -> None:
    from ground.ros2.face import Face

    if z.fleet_name == "*":
        text = "in ROS a vehicle is found by its name alone: name one fleet with --fleet"
        raise BadConfig(text, field="fleet", value="*", expected="one fleet")
    async with Face(z, domain, wanted, say):
        replayed = " (recordings, which take no orders)" if keys.is_replay(z.fleet_name) else ""
        stopped = asyncio.ensure_future(until_stopped())
        await asyncio.sleep(0)  # who reads the line may end us at once
        say(f"fleet {z.fleet_name}{replayed} in ROS domain {domain}")
        await stopped
    leave()
