"""Where a vehicle was, and how it was turned, at the time of a picture: between what it said before and after.

Time matters more than pixels: half a degree of attitude is 9 mm for each metre of height.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Any, TypeVar

from zmav.rotation import wrap
from zmav.wire import Vector

Row = TypeVar("Row", bound=tuple[Any, ...])
KEEP = 3.0
"""s of the past that are kept: pictures over a bad network are so old"""
AHEAD = 0.15
"""s by which the last attitude is carried on at its rate, where a picture comes before the next one"""
GAP = 0.5
"""s between two attitudes beyond which nothing is known between them"""
CARRIED = 1.0
"""s by which a place is carried on with its velocity"""


@dataclass(frozen=True)
class Pose:
    """``pos`` m NED about the fleet's origin; Euler angles (rad) of body against NED; ``rate``: rad/s of tilt then."""

    t: float
    pos: Vector
    roll: float
    pitch: float
    yaw: float
    rate: float


class Poses:
    """The last few seconds. Times are UTC seconds; what comes out of order, or is no number, is left out. A time far
    before the last one begins again: the clock was set back, or the last one was of the future.
    """

    def __init__(self) -> None:
        self._attitudes: list[tuple[float, float, float, float]] = []
        self._places: list[tuple[float, Vector, Vector]] = []

    def turned(self, t: float, roll: float, pitch: float, yaw: float) -> None:
        """An attitude, rad."""
        if all(map(math.isfinite, (t, roll, pitch, yaw))):
            _keep(self._attitudes, (t, roll, pitch, yaw))

    def was(self, t: float, pos: Vector, vel: Vector) -> None:
        """A place and the velocity there."""
        if all(map(math.isfinite, (t, *pos, *vel))):
            _keep(self._places, (t, pos, vel))

    def at(self, t: float) -> Pose | None:
        """None where too little is known of that time."""
        attitude, pos = self._attitude(t), self.place(t)
        return None if attitude is None or pos is None else Pose(t, pos, *attitude)

    def _attitude(self, t: float) -> tuple[float, float, float, float] | None:
        known = self._attitudes
        i = bisect.bisect(known, t, key=lambda each: each[0])
        if i == 0 or len(known) < 2:
            return None
        if i == len(known):
            if t > known[-1][0] + AHEAD:
                return None
            i -= 1
        (t0, *a), (t1, *b) = known[i - 1], known[i]
        if t1 - t0 > GAP:
            return None
        share = (t - t0) / (t1 - t0)
        turn = [wrap(y - x) for x, y in zip(a, b, strict=True)]
        roll, pitch, yaw = (x + share * d for x, d in zip(a, turn, strict=True))
        return roll, pitch, wrap(yaw), math.hypot(turn[0], turn[1]) / (t1 - t0)

    def place(self, t: float) -> Vector | None:
        """Where it was: the nearest two mixed, each carried with its velocity, the nearer one counts more. None where
        neither is near.
        """
        known = self._places
        i = bisect.bisect(known, t, key=lambda each: each[0])
        near = [each for each in known[max(i - 1, 0) : i + 1] if abs(t - each[0]) <= CARRIED]
        if not near:
            return None
        weights = [1.0 / (abs(t - each[0]) + 1e-3) for each in near]
        whole = sum(weights)
        found = [
            sum(w * (pos[k] + (t - at) * vel[k]) for w, (at, pos, vel) in zip(weights, near, strict=True)) / whole
            for k in range(3)
        ]
        return found[0], found[1], found[2]


def _keep(rows: list[Row], row: Row) -> None:
    """Rows begin with their time."""
    t: float = row[0]
    if rows and t < rows[-1][0] - KEEP:
        rows.clear()
    if not (rows and t <= rows[-1][0]):
        rows.append(row)
        while rows[0][0] < t - KEEP:
            del rows[0]
