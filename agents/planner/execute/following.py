"""How one vehicle follows what it is told: how late it is, and how near it then comes to where it should be.

A vehicle that follows late is on its way all the same: it is where its way had it a moment ago. That moment is learnt
from what it says in flight, and what is left over is how well it holds its way, in wind or out of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agents.planner.model.problem import Floats

USUAL = {"px4": (0.45, 0.3), "rover": (0.0, 0.3)}
"""s that an autopilot, or a kind of vehicle, follows late, and m, root mean square, that it is off its way then, before
more is known: PX4 1.16 came 0.4 to 0.5 s late, and in 3 m/s of wind leant away by 0.35 to 0.46 m; rovers leave their
ways where they turn (docs/planner-execution.md)"""
LONGEST = 1.0
"""s: one that is later is not believed to follow"""
MOVING = 0.8
"""m/s from which a vehicle tells how late it is"""
FAST = 3.0
"""m/s from which a look counts whole"""
SURPRISE = 0.5
"""s: one look moves what is known as if it were no farther from it"""
LOOKS, SURE, MOST_LOOKS = 3, 20, 30
"""of what is taken to be known beforehand; from which on lateness is known; and that it goes by at most: 6 s at FAST"""
SPREAD, SPREADS = 0.12, (0.05, 0.5)
"""m, root mean square, that any other is off its way; and what all are taken to be within"""
MOST_OFF = 200
"""looks that how far off its way it is is known by at most: 40 s"""
OUTLIER = 3.0
"""times what is usual that one look counts as at most"""
SIGMAS = 3.0
"""root mean squares within which a vehicle is expected"""

Way = Callable[[float], tuple[Floats, Floats]]
"""place and velocity at a time"""


class Following:
    """Of one vehicle, from flight to flight."""

    def __init__(self, which: str | None = None) -> None:
        self.late, spread = USUAL.get(which or "", (0.0, SPREAD))
        """s"""
        self._looks, self._weights = LOOKS, float(LOOKS)
        self._square, self._seen = spread**2, MOST_LOOKS

    @property
    def spread(self) -> float:
        """m, root mean square, that it is off its way."""
        return float(np.clip(np.sqrt(self._square), *SPREADS))

    @property
    def within(self) -> float:
        """m from its way, late as it is, within which it is expected."""
        return SIGMAS * self.spread

    def heard(self, way: Way, at: float, place: Floats) -> None:
        """It was at ``place`` at ``at``, and is told to fly ``way`` on time."""
        meant, velocity = way(at)
        speed = float(np.linalg.norm(velocity))
        if speed > MOVING:
            late = float(np.dot(meant - place, velocity)) / speed**2
            if not np.isfinite(late):  # of a place that is none: what is learnt is what separation is reckoned by
                return
            late = self.late + float(np.clip(late - self.late, -SURPRISE, SURPRISE))
            weight = min(speed / FAST, 1.0) ** 2  # a place that is off by so much is off by more time the slower it is
            self._weights = min(self._weights + weight, MOST_LOOKS)
            self.late += (float(np.clip(late, 0.0, LONGEST)) - self.late) * weight / self._weights
            self._looks += 1
            if self._looks < SURE:
                return
        off = float(np.linalg.norm(way(at - self.late)[0] - place))
        off = min(off, OUTLIER * self.spread)
        self._seen = min(self._seen + 1, MOST_OFF)
        self._square += (off**2 - self._square) / self._seen
