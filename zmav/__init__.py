"""zmav: one key space for a swarm of real vehicles.

import zmav

async def main():
    async with zmav.open() as z:
        quad = z.vehicle("quad1")
        await quad.arm()
        await quad.takeoff(10)
        await quad.goto(pos=(20, 0, -10))
        await quad.land()

zmav.run(main())
"""

from __future__ import annotations

from zmav.agent import Agent
from zmav.client import Client
from zmav.client import connect as open
from zmav.errors import ZmavError
from zmav.process import run
from zmav.subscription import Subscription
from zmav.vehicle import Lease, Vehicle
from zmav.wire import Setpoint, VehicleState

__all__ = [
    "Agent",
    "Client",
    "Lease",
    "Setpoint",
    "Subscription",
    "Vehicle",
    "VehicleState",
    "ZmavError",
    "open",
    "run",
]
__version__ = "0.1.0"
