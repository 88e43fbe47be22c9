"""Ways that a demo's rover drives: a figure of eight, and a random walk. Metres north and east, seconds, m/s."""

from __future__ import annotations

import asyncio
import math
import random
import time
from collections.abc import Callable

import zmav
from zmav.rotation import wrap

TICK = 0.1
Way = Callable[[float], tuple[float, float]]
"""s from its beginning to a place"""


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
