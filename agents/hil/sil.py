"""The first stage: the fleet file's vehicle flies in the simulator."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

import click

from agents.hil.beside import begun, beside, closing, tell
from agents.hil.checkflight import CheckFlight
from agents.hil.simulator import start_simulator
from zmav.children import Children
from zmav.config import load_fleet
from zmav.errors import LinkDown
from zmav.sim import Remote

SIMULATOR_S = 40.0
"""s for it to start on a busy machine"""


async def sil(
    path: Path, name: str, reports: Path, *, kind: str = "copter", ardupilot: str | None = None, px4: str | None = None
) -> int:
    """Fly the check flight there; 0 where it passed."""
    file = load_fleet(path)
    file.vehicle(name)
    with Children() as children:
        link, by, control = start_simulator(children, file, name, kind=kind, ardupilot=ardupilot, px4=px4)
        report = begun("sil", file, name, by)
        click.echo(f"sil: {file.fleet}/{name} from {path}, flown by {by} at {link}")
        with closing(report, reports), await talk(children, control) as simulator:
            hurry: Callable[[float], object] | None = None if ardupilot or px4 else simulator.speed
            radio = None if ardupilot or px4 else _radio(simulator, name)
            async with beside(children, path, file, name, link) as (client, router):
                flight = CheckFlight(client, file, name, router, children, report, tell, hurry, radio)
                await flight.meet()
                await flight.fly()
        return 0 if report.passed else 1


def _radio(simulator: Remote, name: str) -> Callable[[int, int], object]:
    """A channel of the simulated pilot's radio."""
    return lambda channel, pwm: simulator.pilot(name, None, {channel: pwm})


async def talk(children: Children, control: Path) -> Remote:
    """A word with the simulator, once it runs."""
    deadline = time.monotonic() + SIMULATOR_S
    while True:
        children.check()
        try:
            return Remote(control)
        except LinkDown:
            if time.monotonic() > deadline:
                raise
            await asyncio.sleep(0.1)
