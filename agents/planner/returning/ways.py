"""One vehicle's way home: straight legs between corners, from rest to rest, as the vehicle flies them by itself.

Up where it rests, over the ground at a height of its own, down to above its landing place. Each leg is a trapezoid of
speed, which the cubics of a segment are exactly. ENU metres, seconds by our clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from agents.planner.execute.track import sampled
from agents.planner.model.problem import Floats, Motion

SAMPLE = 0.25
"""s between two samples while the speed changes: at 2 m/s² the chord is 0.016 m off the way"""
SHORTEST, LONGEST = 0.1, 50.0
"""s between two points on the wire (a vehicle takes 0.02 to 60)"""
SHARE = 0.8
"""of its speeds that a vehicle has on its way home: the rest is for wind"""
SHORT = 0.05
"""m: legs that are shorter are none"""


@dataclass(frozen=True)
class Pace:
    """What a vehicle can do, of which :data:`SHARE` is used: m/s over the ground, up and down; m/s²."""

    speed: float
    climb: float
    descend: float
    accel: float

    def along(self, leg: Floats) -> float:
        """m/s on a leg (3,), whose parts over the ground and in height keep each to its own."""
        flat, length = float(np.hypot(leg[0], leg[1])), float(np.linalg.norm(leg))
        steep = self.climb if leg[2] > 0.0 else self.descend
        limits = [self.speed * length / flat if flat > 1e-9 else np.inf]
        limits.append(steep * length / abs(float(leg[2])) if abs(leg[2]) > 1e-9 else np.inf)
        return SHARE * min(limits)


@dataclass(frozen=True, eq=False)
class Way:
    """The corners (K, 3), and when it begins."""

    corners: Floats
    begins: float
    pace: Pace
    late: float = 0.0
    """s after the times of its points at which the vehicle is where they have it"""

    def at(self, begins: float) -> Way:
        """The same at another time."""
        later = Way(self.corners, begins, self.pace, self.late)
        shift = np.zeros(7)
        shift[0] = begins - self.begins
        later.__dict__["rows"] = self.rows + shift
        later.__dict__["motion"] = self.motion + shift[:4]
        later.__dict__["boxes"] = self.boxes
        return later

    @cached_property
    def rows(self) -> Floats:
        """(N, 7): t, place, velocity: the points it is sent as."""
        rows = [np.array([self.begins, *self.corners[0], 0.0, 0.0, 0.0])]
        for here, there in pairwise(self.corners):
            length = float(np.linalg.norm(there - here))
            if length >= SHORT:
                rows += _leg(rows[-1][0], here, (there - here) / length, length, self.pace)
        if len(rows) == 1:
            rows.append(rows[0] + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        found = np.array(rows)
        found[:, 0] = self.begins + np.round(found[:, 0] - self.begins, 3)
        return np.column_stack((found[:, 0], np.round(found[:, 1:], 3)))

    @property
    def ends(self) -> float:
        """When the vehicle is there, late as it is."""
        return float(self.rows[-1, 0]) + self.late

    @cached_property
    def motion(self) -> Motion:
        """(T, 4): t, x, y, z, joined by straight lines: where the vehicle is, late as it is, which is checked."""
        motion = _sampled(self.rows)
        motion[:, 0] += self.late
        return motion

    @cached_property
    def boxes(self) -> Floats:
        """(L, 6): least and greatest x, y, z of each leg."""
        low, high = np.minimum(self.corners[:-1], self.corners[1:]), np.maximum(self.corners[:-1], self.corners[1:])
        return np.hstack((low, high))


def _leg(t: float, here: Floats, unit: Floats, length: float, pace: Pace) -> Iterator[Floats]:
    """The points after the first of one leg, which begins at rest at ``t``."""
    top = min(pace.along(unit), float(np.sqrt(length * SHARE * pace.accel)))
    ramp = top / (SHARE * pace.accel)
    cruise = length / top - ramp
    if cruise < SHORTEST:
        ramp, cruise = length / top, 0.0
    way = 0.5 * top * ramp
    pieces = int(np.ceil(cruise / LONGEST))
    marks = [(ramp, way)]
    marks += [(ramp + cruise * k / pieces, way + top * cruise * k / pieces) for k in range(1, pieces + 1)]
    for since, gone in marks:
        yield np.array([t + since, *(here + unit * gone), *(unit * top)])
    yield np.array([t + 2.0 * ramp + cruise, *(here + unit * length), 0.0, 0.0, 0.0])


def _sampled(rows: Floats) -> Motion:
    """Where its speed stays the ends of a piece are enough."""
    times = [rows[:1, 0]]
    for a, b in pairwise(rows):
        steady = np.abs(a[4:] - b[4:]).max() < 0.02
        count = 1 if steady else max(1, int(np.ceil((b[0] - a[0]) / SAMPLE)))
        times.append(np.linspace(a[0], b[0], count + 1)[1:])
    return sampled(rows, np.concatenate(times))
