"""What surrounds the vehicles: the ground and the moving air, the same for all fleets of a world."""

from __future__ import annotations

import msgspec
import numpy as np

from zmav.errors import BadConfig
from zmav.sim.air import GUSTS, Air
from zmav.sim.arrays import Array

Vector = tuple[float, float, float]
STEEPEST = 1.0  # 45 degrees: nothing stands on more
DEEPEST_M = 10_000.0


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
    def level(self) -> bool:
        return self.slope_north == 0.0 and self.slope_east == 0.0

    @property
    def normal(self) -> Vector:
        """Unit vector out of the ground, NED: (0, 0, -1) where it is level."""
        length = float(np.sqrt(1.0 + self.slope_north**2 + self.slope_east**2))
        return -self.slope_north / length, -self.slope_east / length, -1.0 / length


class Environment:
    """``wind``: the mean, m/s NED, where it blows to. ``gusts``: the turbulence on top of it, one of
    :data:`zmav.sim.air.GUSTS`.

    Raises :class:`BadConfig` for gusts that it does not know, and for ground steeper than 45 degrees or far away.
    """

    def __init__(
        self,
        wind: Vector = (0.0, 0.0, 0.0),
        terrain: Terrain | None = None,
        gusts: str = "none",
    ) -> None:
        if gusts not in GUSTS:
            expected = ", ".join(GUSTS)
            raise BadConfig(f"no gusts {gusts!r}; known: {expected}", field="gusts", value=gusts, expected=expected)
        self.wind = wind
        self.terrain = terrain or Terrain()
        for field in ("slope_north", "slope_east"):
            slope = getattr(self.terrain, field)
            if not abs(slope) <= STEEPEST:
                raise BadConfig(f"{field} {slope}; expected -1 to 1", field=field, value=slope, expected="-1 to 1")
        down = self.terrain.down_m
        if not abs(down) <= DEEPEST_M:
            expected = f"{DEEPEST_M:g} m at most, up or down"
            raise BadConfig(f"down_m {down}; expected {expected}", field="down_m", value=down, expected=expected)
        self.gusts = gusts

    def air(self, n: int, rng: np.random.Generator, dt: float) -> Air:
        """The air about ``n`` vehicles, stepped every ``dt`` seconds. Of ``rng`` only children are used."""
        return Air(self.wind, GUSTS[self.gusts], self.terrain.down, n, rng, dt)
