"""An agent that drives a rover along a way: 'zmav agent run deploy/demos/drive.py --vehicle rover1 -o way=walk'.

It streams positions with velocities under a lease, as any agent for a rover or a boat would.
"""

from __future__ import annotations

import asyncio
import math
import random
import time
from collections.abc import Callable
from typing import Literal

import msgspec

import zmav
from zmav.rotation import wrap

TICK = 0.1
Way = Callable[[float], tuple[float, float]]
"""s from its beginning to a place, m north and east"""


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    way: Literal["eight", "walk"] = "eight"
    speed: float = 1.0
    """m/s at most"""
    seconds: float = 120.0
    seed: int = 1
    """of a walk"""


class Drive(zmav.Agent):
    """Drives from where the rover stands: a figure of eight, or a random walk."""

    name = "drive"
    settings_type = Settings

    async def run(self) -> None:
        how: Settings = self.settings
        state = await self.vehicle.wait_until(lambda s: s.ready is True and s.local is not None, 60.0)
        assert state.local is not None
        way = eight(how.speed) if how.way == "eight" else walk(how.speed, how.seed)
        self.status("drive", f"{how.way}, up to {how.speed:g} m/s")
        await drive(self.vehicle, way, (state.local[0], state.local[1]), how.seconds)
        self.status("done")


def eight(speed: float, length: float = 9.0, width: float = 4.0) -> Way:
    """Lying along north, through the origin, ``speed`` m/s at its fastest."""
    turn = speed / math.hypot(length, 2.0 * width)

    def place(t: float) -> tuple[float, float]:
        return length * math.sin(turn * t), width * math.sin(2.0 * turn * t)

    return place


def walk(speed: float, seed: int, reach: float = 10.0, seconds: float = 4000.0) -> Way:
    """Heading and speed (up to ``speed``) change all the time, at random, and back where it leaves ``reach`` metres."""
    rng, places, heading, now = random.Random(seed), [(0.0, 0.0)], 0.0, 0.3 * speed
    for _ in range(int(seconds / TICK)):
        north, east = places[-1]
        heading += rng.gauss(0.0, 0.12)
        now = min(max(now + rng.gauss(0.0, 0.05), 0.2 * speed), speed)
        if math.hypot(north, east) > reach:  # turn in, by at most what a rover can
            home = math.atan2(-east, -north)
            off = wrap(home - heading)
            heading += max(-0.12, min(0.12, off))
        places.append((north + now * math.cos(heading) * TICK, east + now * math.sin(heading) * TICK))

    def place(t: float) -> tuple[float, float]:
        i = min(max(t / TICK, 0.0), len(places) - 1.001)
        k = int(i)
        (a, b), (c, d) = places[k], places[k + 1]
        return a + (i - k) * (c - a), b + (i - k) * (d - b)

    return place


async def drive(rover: zmav.Vehicle, way: Way, start: tuple[float, float], seconds: float) -> None:
    """Under a lease, in GUIDED or what its autopilot calls it; it stops where it is at the end or when cancelled."""
    async with rover.lease("driver") as lease:
        await rover.arm()
        begun = time.monotonic()
        origin = way(0.0)
        while (t := time.monotonic() - begun) < seconds:
            (a, b), (c, d) = way(t), way(t + TICK)
            vel = ((c - a) / TICK, (d - b) / TICK, 0.0)
            lease.setpoint(pos=(start[0] + a - origin[0], start[1] + b - origin[1], 0.0), vel=vel)
            await asyncio.sleep(TICK)
