"""One vehicle flies a square over where it stands, and lands. Ctrl-C: it holds ('zmav do quad1 land' ends that).

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/square.py              # or with the endpoint of a router: tcp/10.0.0.7:7447
"""

from __future__ import annotations

import asyncio
import sys

import zmav

SIDE, HEIGHT = 12.0, 8.0  # m


async def fly(quad: zmav.Vehicle) -> None:
    await quad.arm()  # waits until the autopilot is ready
    north, east, down = quad.local  # metres from the fleet's origin, where it stands
    await quad.takeoff(HEIGHT)
    for n, e in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0)):
        await quad.goto(pos=(north + n, east + e, down - HEIGHT))  # returns on arrival
        print(f"{quad.name}: corner {n:.0f} m north, {e:.0f} m east", flush=True)
    await quad.land()


async def main(*endpoints: str) -> None:
    async with zmav.open(connect=endpoints) as z:
        (quad,) = await z.wait_for("quad1")
        try:
            await fly(quad)
        except asyncio.CancelledError:  # Ctrl-C: an order goes on without us unless another one ends it
            await quad.hold()
            raise


if __name__ == "__main__":
    zmav.run(main(*sys.argv[1:]))
