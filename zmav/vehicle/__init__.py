"""A vehicle as agents and scripts see it, one part a file."""

from __future__ import annotations

from zmav.vehicle.lease import Lease
from zmav.vehicle.params import Difference, Params, differences
from zmav.vehicle.vehicle import Vehicle

__all__ = ["Difference", "Lease", "Params", "Vehicle", "differences"]
