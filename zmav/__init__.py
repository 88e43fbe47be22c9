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

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
__version__ = "0.2.0"
_PLACES = {
    "Agent": "zmav.agent",
    "Client": "zmav.client",
    "Lease": "zmav.vehicle",
    "Setpoint": "zmav.wire",
    "Subscription": "zmav.subscription",
    "Vehicle": "zmav.vehicle",
    "VehicleState": "zmav.wire",
    "ZmavError": "zmav.errors",
    "run": "zmav.process",
}


def __getattr__(name: str) -> Any:
    """What a script uses, and the modules themselves, loaded when first used: 'zmav --help' and a router need few."""
    if name == "open":
        found = importlib.import_module("zmav.client").connect
    elif name in _PLACES:
        found = getattr(importlib.import_module(_PLACES[name]), name)
    elif name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        try:
            found = importlib.import_module(f"zmav.{name}")
        except ModuleNotFoundError as e:
            if e.name != f"zmav.{name}":
                raise
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    globals()[name] = found
    return found
