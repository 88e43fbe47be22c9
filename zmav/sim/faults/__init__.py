"""What can go wrong on command: a fault is put on a vehicle by name, for a time or until it is cleared.

world.fault("quad2", "gps-loss", for_s=10)
world.fault("quad1", "motor", number=2, efficiency=0.3)
world.clear("quad1")
"""

from __future__ import annotations

from zmav.sim.faults.base import Fault, FaultStatus
from zmav.sim.faults.injector import Faults
from zmav.sim.faults.table import KINDS, make_fault

__all__ = ["KINDS", "Fault", "FaultStatus", "Faults", "make_fault"]
