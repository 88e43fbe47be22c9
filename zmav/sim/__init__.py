"""The embedded simulator: vehicles that behave as real autopilots do, without anything to install.

with World(copters=3, speed=4) as world:
    print(world.urls)
"""

from __future__ import annotations

from zmav.sim.remote import Remote
from zmav.sim.spec import Home, VehicleSpec
from zmav.sim.status import VehicleStatus, WorldStatus
from zmav.sim.vehicle import SimVehicle
from zmav.sim.world import DEFAULT_READY_S, REALISTIC_READY_S, World

__all__ = [
    "DEFAULT_READY_S",
    "REALISTIC_READY_S",
    "Home",
    "Remote",
    "SimVehicle",
    "VehicleSpec",
    "VehicleStatus",
    "World",
    "WorldStatus",
]
