"""Three vehicles take off, gather in a V and keep it while it moves north; then they land. Ctrl-C: all hold.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/formation.py           # or with the endpoint of a router: tcp/10.0.0.7:7447
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
import time

import zmav

HEIGHT, SPEED, DISTANCE, RATE = 10.0, 2.0, 40.0, 10.0  # m, m/s, m, Hz
SLOTS = ((-6.0, -6.0), (0.0, 0.0), (-6.0, 6.0))  # m north and east of the point of the V, from west to east


async def rise(vehicle: zmav.Vehicle) -> None:
    await vehicle.arm()
    await vehicle.takeoff(HEIGHT)


async def keep(leases: list[zmav.Lease], north: float, east: float, down: float) -> None:
    """Setpoints to all by one clock: a half second without, and they would hold. It moves when all are in place."""
    begun: float | None = None
    ahead = 0.0
    while ahead < DISTANCE:
        ahead = SPEED * (time.monotonic() - begun) if begun is not None else 0.0
        goals = [(north + ahead + n, east + e, down) for n, e in SLOTS]
        for lease, goal in zip(leases, goals, strict=True):
            lease.setpoint(pos=goal, vel=(SPEED if begun else 0.0, 0.0, 0.0))
        if begun is None and all(math.dist(x.vehicle.local, g) < 1.0 for x, g in zip(leases, goals, strict=True)):
            begun = time.monotonic()
            print("gathered: moving", flush=True)
        await asyncio.sleep(1.0 / RATE)


async def main(*endpoints: str) -> None:
    async with zmav.open(connect=endpoints) as z:
        fleet = sorted(await z.wait_for("quad1", "quad2", "quad3"), key=lambda v: v.local[1])  # no paths cross
        async with contextlib.AsyncExitStack() as held:  # given back at the end, come what may: they hold
            leases = [await held.enter_async_context(v.lease("formation")) for v in fleet]
            north, east, down = fleet[1].local  # on the ground: the point of the V begins above it
            await asyncio.gather(*(rise(v) for v in fleet))
            await keep(leases, north, east, down - HEIGHT)
        await asyncio.gather(*(v.land() for v in fleet))


if __name__ == "__main__":
    zmav.run(main(*sys.argv[1:]))
