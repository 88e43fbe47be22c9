"""How far the vehicle's position estimate has wandered from where its velocity alone would have brought it.

An estimate follows its GPS, whose error changes by a decimetre or two within a second, and jumps where the filter is
set again. The velocity beside it is good to some 0.05 m/s and does not jump. So over the seconds in which a target is
filtered, and in which it is flown over unseen, a place is better kept in a frame that moves with this drift: a frame
of odometry, as in REP 105 of the Robot Operating System (https://www.ros.org/reps/rep-0105.html).
"""

from __future__ import annotations

import numpy as np

from zmav.wire import Vector

LONGEST = 1.5
"""s between two states over which a velocity tells what was between them"""
STEP = 0.2
"""s by which the time between two states may differ from that between hearing them; else a clock was set"""
KEPT = 5.0
"""s of the past that can be asked about"""


class PositionDrift:
    """Metres north and east, 0 at the first state. Times are UTC seconds. No clock and no network in here."""

    def __init__(self) -> None:
        self._last: tuple[float, float, Vector, Vector] | None = None
        self._past: list[tuple[float, float, float]] = []

    def feed(self, t: float, heard: float, pos: Vector, vel: Vector) -> None:
        """A state of ``t``, ``heard`` at that time of a clock that nobody sets (s): where the vehicle was (m NED) and
        how it moved (m/s NED). An older one is left out. Over a gap, or where the clock was set, the drift stays.
        """
        north = east = 0.0
        if self._last is not None:
            (before, heard_before, (a, b, _), (u, v, _)), (_, north, east) = self._last, self._past[-1]
            since = t - before
            if abs(since - (heard - heard_before)) <= STEP:
                if since <= 0.0:
                    return
                if since < LONGEST:
                    north += pos[0] - a - since * (vel[0] + u) / 2.0
                    east += pos[1] - b - since * (vel[1] + v) / 2.0
        self._last = t, heard, pos, vel
        self._past = [each for each in self._past if t - KEPT < each[0] < t]
        self._past.append((t, north, east))

    def at(self, t: float) -> tuple[float, float]:
        """At ``t``: interpolated; outside of what is kept, as at its nearer end."""
        if not self._past:
            return 0.0, 0.0
        times, north, east = zip(*self._past, strict=True)
        return float(np.interp(t, times, north)), float(np.interp(t, times, east))
