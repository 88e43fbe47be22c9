"""The moving air that surrounds the vehicles, the same for all fleets of a world. The ground is level, at the world's
origin.
"""

from __future__ import annotations

from zmav.errors import BadConfig
from zmav.sim.air import GUSTS, Air

Vector = tuple[float, float, float]


class Environment:
    """``wind``: the mean, m/s NED, where it blows to. ``gusts``: the turbulence on top of it, one of
    :data:`zmav.sim.air.GUSTS`; :class:`BadConfig` for others.
    """

    def __init__(self, wind: Vector = (0.0, 0.0, 0.0), gusts: str = "none") -> None:
        if gusts not in GUSTS:
            expected = ", ".join(GUSTS)
            raise BadConfig(f"no gusts {gusts!r}; known: {expected}", field="gusts", value=gusts, expected=expected)
        self.wind = wind
        self.gusts = gusts

    def air(self, n: int, seed: tuple[int, ...], dt: float) -> Air:
        """The air about ``n`` vehicles, stepped every ``dt`` seconds."""
        return Air(self.wind, GUSTS[self.gusts], n, seed, dt)
