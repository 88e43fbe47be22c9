"""What surrounds the vehicles: the ground and the moving air, the same for all fleets of a world."""

from __future__ import annotations

import msgspec
import numpy as np

from zmav.sim.arrays import Array

Vector = tuple[float, float, float]


class Terrain(msgspec.Struct, frozen=True):
    """The ground: a plane through ``down_m`` below the world's origin that rises by ``slope_north`` and
    ``slope_east`` metres for each metre to the north and the east.
    """

    down_m: float = 0.0
    slope_north: float = 0.0
    slope_east: float = 0.0

    def down(self, north: Array, east: Array) -> Array:
        """Where the ground is, metres down of the world's origin, (N,)."""
        return self.down_m - self.slope_north * north - self.slope_east * east

    @property
    def normal(self) -> Vector:
        """Unit vector out of the ground, NED: (0, 0, -1) where it is level."""
        length = float(np.sqrt(1.0 + self.slope_north**2 + self.slope_east**2))
        return -self.slope_north / length, -self.slope_east / length, -1.0 / length


class Environment:
    """``wind``: the mean, m/s NED, where it blows to."""

    def __init__(self, wind: Vector = (0.0, 0.0, 0.0), terrain: Terrain | None = None) -> None:
        self.wind = wind
        self.terrain = terrain or Terrain()
