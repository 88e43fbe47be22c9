"""All vehicles that are there take off together; of those that do not, the reasons are told. Ctrl-C: all hold.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/takeoff.py             # or with the endpoint of a router: tcp/10.0.0.7:7447
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable

import zmav

HEIGHT = 10.0  # m above home


async def each(vehicles: list[zmav.Vehicle], order: Callable[[zmav.Vehicle], Awaitable[None]]) -> list[zmav.Vehicle]:
    """Give an order to all at once; those that did it. One that refuses keeps nobody else on the ground."""
    results = await asyncio.gather(*(order(v) for v in vehicles), return_exceptions=True)
    for vehicle, error in zip(vehicles, results, strict=True):
        if isinstance(error, zmav.ZmavError):
            print(f"{vehicle.name}: {error}", flush=True)
        elif error is not None:
            raise error
    return [vehicle for vehicle, error in zip(vehicles, results, strict=True) if error is None]


async def main(*endpoints: str) -> int:
    async with zmav.open(connect=endpoints) as z:
        fleet = await z.settle()  # anyone who is there
        try:
            armed = await each(fleet, lambda v: v.arm(ready_timeout=30.0))
            risen = await each(armed, lambda v: v.takeoff(HEIGHT))
        except asyncio.CancelledError:
            await each(fleet, lambda v: v.hold())
            raise
        print(f"{len(risen)} of {len(fleet)} are {HEIGHT:.0f} m up", flush=True)
        return 0 if len(risen) == len(fleet) > 0 else 1


if __name__ == "__main__":
    zmav.run(main(*sys.argv[1:]))
