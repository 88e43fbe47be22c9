"""How far along a straight leg a copter is at which time: from rest to rest with limited speed, acceleration and jerk.

Seven segments (jerk up, constant acceleration, jerk down, cruise, and the same backwards). After Biagiotti and
Melchiorri, "Trajectory Planning for Automatic Machines and Robots", section 3.4; ArduPilot's legs are of this kind
(ardupilot.org, "Copter Position Control and Navigation", "S-Curves"), with jerk that also rises smoothly.
"""

from __future__ import annotations

import math

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
