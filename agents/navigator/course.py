"""A trajectory as it is flown: what of it is due by the clock, what of the route is left, and how it is stopped."""

from __future__ import annotations

import numpy as np

from agents.navigator.routes import Route
from agents.navigator.trajectory import WINDOW, Trajectory
from zmav import wire

OVERLAP = 10.0
"""s before a segment would brake at which the next one is given: so long a network may be silent"""
NOTICE = 0.3
"""s from a word to stop until it brakes: what is given has to come there first"""
STAY = 30.0
"""s that a stay lasts unless it is given again"""


class Course:
    """``start``: UTC s of the trajectory's beginning; ``done``: m of the route that were flown before it."""

    def __init__(self, trajectory: Trajectory, start: float, done: float = 0.0) -> None:
        self.trajectory, self.start, self.done = trajectory, start, done
        self._until = 0.0
        """s on the trajectory from which nothing is given yet"""
        self._stays = 0.0
        """UTC s at which the stay that was given ends"""

    def due(self, now: float) -> list[wire.SegmentPoint] | None:
        """The next segment, where it is time to give it (UTC s)."""
        t = now - self.start
        if t < self._until - OVERLAP or self._until >= self.trajectory.duration:
            return None
        begin = max(t, 0.0)
        self._until = min(begin + WINDOW, self.trajectory.duration)
        return self.trajectory.segment(begin, self.start)

    def brake(self, now: float) -> None:
        """Come to rest along the way; this is due at once."""
        self.trajectory = self.trajectory.braked(min(max(now + NOTICE - self.start, 0.0), self.trajectory.duration))
        self._until = 0.0

    def stay(self, now: float) -> list[wire.SegmentPoint] | None:
        """At rest where it ended, where it is time to give that again."""
        if not self.ended(now) or now < self._stays - OVERLAP:
            return None
        self._stays = now + STAY
        (first, *_) = self.trajectory.points(self.trajectory.duration, 0.0)
        return [wire.SegmentPoint(t=now + t, pos=first.pos, vel=(0.0, 0.0, 0.0), yaw=first.yaw) for t in (0.0, STAY)]

    def ended(self, now: float) -> bool:
        return now - self.start >= self.trajectory.duration

    def along(self, now: float) -> float:
        """m of the route, which is zero on the way to it."""
        s = float(self.trajectory.law.at(np.array([now - self.start]))[0][0])
        return self.done + max(0.0, s - self.trajectory.route.begins)

    def place(self, now: float) -> wire.Vector:
        """m NED where it should be"""
        north, east, down = map(float, self.trajectory.at(np.array([now - self.start])).pos[0])
        return north, east, down

    def left(self, now: float) -> Route | None:
        """What is left of the route, without the way to it; None: nothing."""
        s = float(self.trajectory.law.at(np.array([now - self.start]))[0][0])
        return self.trajectory.route.after(max(s, self.trajectory.route.begins))
