"""The embedded 3.2 kg hexarotor under PX4 1.13 rules, in the air, and what it is to fly: a lemniscate in haste."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import time
from collections.abc import AsyncIterator

import msgspec
import numpy as np

from agents.controllers.types import Array, plain
from tests.bench.controllers.processes import START, VEHICLE, Rig, fleet_file, last_words, rig
from zmav import wire
from zmav.process import free_port
from zmav.sim import Remote

SIMULATOR = "simulator"
HEIGHT = 10.0
"""m above home"""
CENTRE: wire.Vector = (0.0, 0.0, -HEIGHT)
YAW = 0.0
"""where everything is flown, m NED about home, and the heading"""
STILL = 3.0
"""s at rest before it begins"""
TICK_HZ = 500
LENGTH, WIDTH, PACE = 5.0, 2.5, 0.75
"""m and rad/s of the lemniscate: up to 5.3 m/s and 5.7 m/s² (30° of tilt)"""
BUILD_UP = 3.0
"""s in which it comes to its pace, and from it to rest"""
APART = 0.15
"""s between two points of a segment"""


@contextlib.asynccontextmanager
async def airborne(wind: str = "0", noise: str = "typical", seed: int = 1) -> AsyncIterator[Rig]:
    """The simulator, the vehicle's agent, and the vehicle in the air above home. ``wind`` as of ``zmav sim``."""
    with last_words() as processes:
        port = free_port(socket.SOCK_DGRAM)
        sim = f'[vehicles.{VEHICLE}.sim]\nautopilot = "px4"\nairframe = "hexa"\nfirmware = "1.13"\n'
        world = f'[sim]\ntick_hz = {TICK_HZ}\nnoise = "{noise}"\nwind = "{wind}"\nseed = {seed}\n'
        file = fleet_file(processes, f"udpin:127.0.0.1:{port}", sim, world)
        control = processes.folder / "control"
        processes.start(SIMULATOR, "sim", "--fleet", str(file), "--control", str(control))
        async with rig(processes, file) as run:
            await run.vehicle.wait_until(lambda state: state.connected, START)
            with Remote(control) as remote:  # a pilot is beside it, whose radio is on and whose hands rest
                remote.pilot(VEHICLE)
            await run.vehicle.arm()
            await run.vehicle.takeoff(HEIGHT)
            yield run


def lemniscate(t: float, seconds: float, centre: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (3,) at ``t`` s of ``seconds``: a figure of eight that begins and ends at
    rest in its middle, ``centre`` (m NED).
    """
    turns = max(1.0, math.floor(PACE * (seconds - BUILD_UP) / math.tau)) * math.tau
    pace = turns / (seconds - BUILD_UP)
    angle, rate, spin = _ramped(t, seconds, pace)
    c, s, c2, s2 = math.cos(angle), math.sin(angle), math.cos(2.0 * angle), math.sin(2.0 * angle)
    place = np.array([LENGTH * s, WIDTH * s2, 0.0])
    slope = np.array([LENGTH * c, 2.0 * WIDTH * c2, 0.0])
    bend = np.array([-LENGTH * s, -4.0 * WIDTH * s2, 0.0])
    return centre + place, slope * rate, bend * rate * rate + slope * spin


def _ramped(t: float, seconds: float, pace: float) -> tuple[float, float, float]:
    """An angle, its rate and that one's: from rest to ``pace`` and back as the smooth step 3 s² - 2 s³."""
    t = min(max(t, 0.0), seconds)
    if t > 0.5 * seconds:
        angle, rate, spin = _ramped(seconds - t, seconds, pace)
        return pace * (seconds - BUILD_UP) - angle, rate, -spin
    share = min(t / BUILD_UP, 1.0)
    rate, spin = pace * share * share * (3.0 - 2.0 * share), pace * 6.0 * share * (1.0 - share) / BUILD_UP
    return pace * (BUILD_UP * (share**3 - 0.5 * share**4) + max(t - BUILD_UP, 0.0)), rate, spin


def segment(begin: float, seconds: float, centre: Array, yaw: float) -> list[wire.SegmentPoint]:
    """The lemniscate from ``begin`` (UTC s) on."""
    points = []
    for t in np.linspace(0.0, seconds, round(seconds / APART) + 1):
        pos, vel, acc = lemniscate(float(t), seconds, centre)
        points.append(wire.SegmentPoint(t=begin + float(t), pos=plain(pos), vel=plain(vel), acc=plain(acc), yaw=yaw))
    return points


async def rest(run: Rig, agent: str) -> None:
    """Have a controller that flies go to the :data:`CENTRE` and come to rest there."""
    went = await run.vehicle.tell(agent, "goto", pos=CENTRE, yaw=YAW)
    await asyncio.sleep(float(went["seconds"]) + STILL)


async def follow(run: Rig, agent: str, seconds: float) -> float:
    """Have a controller that flies go to the :data:`CENTRE` and then along the lemniscate about it; gives when that
    begins (UTC s).
    """
    await rest(run, agent)
    begin = time.time() + 1.0
    points = segment(begin, seconds, np.array(CENTRE), YAW)
    await run.vehicle.tell(agent, "follow", segment=[msgspec.to_builtins(point) for point in points])
    return begin
