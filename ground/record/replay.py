"""``zmav replay``: a recorded flight as a vehicle on the key space."""

from __future__ import annotations

import asyncio
import time

import click

from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.links import LinkState
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import until_stopped
from zmav.session import SessionSettings, open_session


@click.command("replay")
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option("--name", default="replay", show_default=True, help="Vehicle name to replay as.")
@click.option("--speed", default="1", show_default=True, help="Times real time; 'max' as fast as it goes.")
@click.option("--loop", is_flag=True, help="Begin again at the end.")
@click.option("--sysid", type=click.IntRange(1, 255), help="Which system is the vehicle, where there are several.")
@click.option("--dialect", default="ardupilotmega", show_default=True)
@fleet_option
@zenoh_options
def command(
    file: str, name: str, speed: str, loop: bool, sysid: int | None, dialect: str, fleet: str, settings: SessionSettings
) -> None:
    """Play a .tlog into the key space: frames byte for byte, state, messages and events as in flight."""
    url = f"replay:{file}?speed={speed}" + ("&loop=1" if loop else "")
    vehicle = OnboardSettings(link=url, name=name, fleet=fleet, sysid=sysid, dialect=dialect)
    run(_replay(vehicle, settings))


async def _replay(vehicle: OnboardSettings, settings: SessionSettings) -> None:
    with await asyncio.to_thread(open_session, settings) as session:
        async with Onboard(session, vehicle) as onboard:
            click.echo(f"replaying {vehicle.link} as {vehicle.fleet}/{vehicle.name}", err=True)
            start = time.monotonic()
            ways_to_end = {asyncio.create_task(until_stopped()), asyncio.create_task(_until_played(onboard))}
            _, unfinished = await asyncio.wait(ways_to_end, return_when=asyncio.FIRST_COMPLETED)
            for task in unfinished:
                task.cancel()
            count = onboard.adapter.splitter.counters
            click.echo(
                f"{count.frames} frames ({count.unknown} unknown, {count.lost} lost) in "
                f"{time.monotonic() - start:.1f} s",
                err=True,
            )


async def _until_played(onboard: Onboard) -> None:
    """A recording that is not repeated ends with its link down."""
    while not await asyncio.to_thread(onboard.adapter.link.wait, LinkState.DOWN, 0.5):
        pass
