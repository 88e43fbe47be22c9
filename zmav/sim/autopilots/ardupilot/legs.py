"""Straight legs that run into each other: how ArduPilot's copters and rovers go from place to place.

In a corner the next leg begins while the last one ends, and their motions add up; it begins as late as keeps the turn
close to the corner. From rest to rest with limited speed, acceleration and jerk: Biagiotti and Melchiorri, "Trajectory
Planning for Automatic Machines and Robots", section 3.4.
Source: ardupilot.org, "Copter Position Control and Navigation", "S-Curves".
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

Numbers = tuple[float, ...]
SHORTEST_M = 1e-3


class Profile:
    """A leg of ``length`` metres; ``duration`` and ``ramp`` (the time to get up to speed) in seconds."""

    def __init__(self, length: float, speed: float, accel: float, jerk: float) -> None:
        self.length = max(length, 0.0)
        if self.length < SHORTEST_M:
            self.ramp = self.duration = self.speed = 0.0
            self._jerk_s = self._hold_s = self._jerk = 0.0
            return
        self._jerk = jerk
        rise = min(accel / jerk, math.sqrt(speed / jerk))
        hold = max(speed / (jerk * rise) - rise, 0.0)
        if jerk * rise * (rise + hold) * (2.0 * rise + hold) > self.length:
            # There is no time to cruise: first less of constant acceleration, then less of that at all.
            rise = min(rise, (self.length / (2.0 * jerk)) ** (1.0 / 3.0))
            # length = jerk * rise * (rise + hold) * (2 * rise + hold)
            root = math.sqrt(rise * rise / 4.0 + self.length / (jerk * rise))
            hold = max(root - 1.5 * rise, 0.0)
        self._jerk_s, self._hold_s = rise, hold
        self.ramp = 2.0 * rise + hold
        self.speed = jerk * rise * (rise + hold)
        cruise = max(self.length - self.speed * self.ramp, 0.0) / self.speed
        self.duration = 2.0 * self.ramp + cruise

    def at(self, t: float) -> tuple[float, float, float]:
        """Distance gone, speed and acceleration at ``t`` seconds; before and after, those of the ends."""
        if t >= self.duration:
            return self.length, 0.0, 0.0
        if t <= 0.0:
            return 0.0, 0.0, 0.0
        if t > self.duration - self.ramp:
            gone, speed, accel = self._rise(self.duration - t)
            return self.length - gone, speed, -accel
        if t > self.ramp:
            return self.speed * (t - 0.5 * self.ramp), self.speed, 0.0
        return self._rise(t)

    def _rise(self, t: float) -> tuple[float, float, float]:
        """The way up to speed."""
        jerk, rise, hold = self._jerk, self._jerk_s, self._hold_s
        if t <= rise:
            return jerk * t**3 / 6.0, jerk * t * t / 2.0, jerk * t
        accel = jerk * rise
        if t <= rise + hold:
            since = t - rise
            speed = accel * rise / 2.0
            return accel * rise * rise / 6.0 + speed * since + accel * since * since / 2.0, speed + accel * since, accel
        # The last part is the first one, seen from its end.
        left = self.ramp - t
        return (
            self.speed * (t - 0.5 * self.ramp) + jerk * left**3 / 6.0,
            self.speed - jerk * left * left / 2.0,
            jerk * left,
        )


class Leg:
    """One straight from ``start`` to ``end``, and how far it is gone; ``planned``: the ground speed that it is for."""

    def __init__(self, start: Numbers, end: Numbers, limits: tuple[float, float, float], planned: float) -> None:
        self.start, self.end, self.planned = start, end, planned
        self.time = 0.0
        length = math.dist(start, end)
        self.profile = Profile(length, *limits)
        self.along: Numbers = tuple((e - s) / length if length > 0 else 0.0 for s, e in zip(start, end, strict=True))

    @property
    def left(self) -> float:
        """Seconds to the end."""
        return max(self.profile.duration - self.time, 0.0)

    def motion(self, ahead: float = 0.0) -> tuple[float, float, float]:
        """Distance gone, speed and acceleration, now or so many seconds later."""
        return self.profile.at(self.time + ahead)

    def gone_beyond(self, place: Sequence[float]) -> float:
        """Metres that ``place`` lies beyond the end, along the leg."""
        return sum((p - e) * a for p, e, a in zip(place, self.end, self.along, strict=True))


class Legs(ABC):
    """The leg that is gone, and in a corner the one before or after it."""

    def __init__(self) -> None:
        self.reached = False
        self._leg: Leg | None = None
        self._last: Leg | None = None
        self._next: Leg | None = None
        self._pace = 1.0

    @abstractmethod
    def _turn_fits(self, leg: Leg, following: Leg, off: float, speed: float, push: Sequence[float]) -> bool:
        """Whether a turn may begin now: in its middle it is ``off`` the corner by so many metres, at ``speed`` m/s, and
        accelerates by ``push`` (a vector, m/s^2).
        """

    def _advance(self, leg: Leg, step: float) -> bool:
        """Go on by so many seconds of the plan; True where it is time to look for the turn onto the next leg."""
        leg.time += step
        if self._last is not None:
            self._last.time += step
            if self._last.left == 0.0:
                self._last = None
        if self._next is not None:
            self._next.time += step
            return False
        return not self.reached and leg.left <= leg.profile.ramp

    def _begin_turn(self, leg: Leg, following: Leg) -> None:
        """Begin the next leg where the turn fits."""
        half = 0.5 * leg.left
        if leg.left > following.profile.ramp:
            return
        gone, *ending = leg.motion(half)
        on, *beginning = following.motion(half)
        before = gone - leg.profile.length
        off, turn, push = (
            [a * end + b * start for a, b in zip(leg.along, following.along, strict=True)]
            for end, start in zip((before, *ending), (on, *beginning), strict=True)
        )
        if self._turn_fits(leg, following, math.hypot(*off), math.hypot(*turn), push):
            self._next = following

    def _motion(self, leg: Leg) -> tuple[list[float], list[float], list[float]]:
        """Place about the leg's end, velocity and acceleration: the sum of what the legs of a corner ask for."""
        parts = []
        for each, ends in ((leg, True), (self._last, True), (self._next, False)):
            if each is not None:
                gone, speed, accel = each.motion()
                parts.append((each.along, (gone - each.profile.length if ends else gone, speed, accel)))
        place, vel, acc = ([sum(a[i] * part[k] for a, part in parts) for i in range(len(leg.along))] for k in range(3))
        return place, vel, acc
