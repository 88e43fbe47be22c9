"""A vehicle as agents and scripts see it, one part a file."""

from __future__ import annotations

from zmav.vehicle.files import Files, Logs
from zmav.vehicle.lease import Lease
from zmav.vehicle.missions import Missions
from zmav.vehicle.params import Difference, Params, differences
from zmav.vehicle.rates import Rates
from zmav.vehicle.terrain import GroundPieces
from zmav.vehicle.vehicle import Vehicle

__all__ = [
    "Difference",
    "Files",
    "GroundPieces",
    "Lease",
    "Logs",
    "Missions",
    "Params",
    "Rates",
    "Vehicle",
    "differences",
]
