"""How far the vehicle's position estimate has wandered from where its velocity alone would have brought it.

An estimate follows its GPS, whose error changes by a decimetre or two within a second, and jumps where the filter is
set again. The velocity beside it is good to some 0.05 m/s and does not jump. So over the seconds in which a target is
filtered, and in which it is flown over unseen, a place is better kept in a frame that moves with this drift: a frame
of odometry, as in REP 105 of the Robot Operating System (https://www.ros.org/reps/rep-0105.html).
"""

from __future__ import annotations

import bisect

from zmav.wire import Vector

LONGEST = 1.0
"""s between two states over which a velocity tells what was between them"""
KEPT = 5.0
"""s of the past that can be asked about"""


class PositionDrift:
    """Metres north and east, 0 at the first state. Times are UTC seconds. No clock and no network in here."""

    def __init__(self) -> None:
        self._last: tuple[float, Vector, Vector] | None = None
        self._past: list[tuple[float, float, float]] = []

    def feed(self, t: float, pos: Vector, vel: Vector) -> None:
        """A state of ``t``: where the vehicle was (m NED) and how it moved (m/s NED). An older one is left out, unless
        the clock was set back.
        """
        north = east = 0.0
        if self._last is not None:
            (before, (a, b, _), (u, v, _)), (_, north, east) = self._last, self._past[-1]
            since = t - before
            if -KEPT < since <= 0.0:
                return
            if 0.0 < since < LONGEST:
                north += pos[0] - a - since * (vel[0] + u) / 2.0
                east += pos[1] - b - since * (vel[1] + v) / 2.0
        self._last = t, pos, vel
        self._past = [each for each in self._past if t - KEPT < each[0] < t]
        self._past.append((t, north, east))

    def at(self, t: float) -> tuple[float, float]:
        """At ``t``: interpolated, and before the first and after the last state as there."""
        if not self._past:
            return 0.0, 0.0
        i = bisect.bisect([each[0] for each in self._past], t)
        a, b = self._past[max(i - 1, 0)], self._past[min(i, len(self._past) - 1)]
        share = (t - a[0]) / (b[0] - a[0]) if b[0] > a[0] else 0.0
        return a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
