"""Where a copter that flies by itself points its nose: ArduCopter's "auto yaw" (WP_YAW_BEHAVIOR, yaw in targets,
CONDITION_YAW, regions of interest).
"""

from __future__ import annotations

import enum
import math

from zmav.sim.control.setpoints import SetpointHandle
from zmav.sim.fleets.base import Sense

LOOK_SHARE = 0.05  # of the allowed speed: slower motion does not turn the nose
ARRIVED = math.radians(2.0)


class Look(enum.Enum):
    FIXED = "fixed"
    ALONG = "along"
    RATE = "rate"
    SWEEP = "sweep"  # on its way to a fixed heading, at a given rate and in a given direction
    POINT = "point"


class Heading:
    """One vehicle's auto yaw."""

    def __init__(self, setpoint: SetpointHandle) -> None:
        self._sp = setpoint
        self.look = Look.FIXED
        self.rate = 0.0
        self._yaw = 0.0
        self._left = 0.0
        self._point = (0.0, 0.0)

    def hold(self, yaw: float) -> None:
        """Turn to ``yaw`` (radians) and keep it."""
        self.look = Look.FIXED
        self._yaw = yaw
        self._sp.heading(yaw)

    def turn(self, rate: float) -> None:
        """Turn at ``rate`` rad/s until told otherwise."""
        self.look, self.rate = Look.RATE, rate
        self._sp.turn(rate)

    def sweep(self, start: float, angle: float, rate: float, direction: float, *, relative: bool) -> None:
        """Turn from ``start`` to ``angle`` (from there on where ``relative``), radians, at ``rate`` rad/s (0: the
        highest), clockwise for a positive ``direction``, the other way for a negative, the short way for none.
        """
        if relative:
            self._left = angle * (1.0 if direction >= 0 else -1.0)
        else:
            self._left = (angle - start + math.pi) % (2.0 * math.pi) - math.pi
            if direction < 0 < self._left:
                self._left -= 2.0 * math.pi
            elif direction > 0 > self._left:
                self._left += 2.0 * math.pi
        highest = self._sp.limit_of("yaw_slew")
        self.rate = min(rate, highest) if rate > 0 else highest
        self.look, self._yaw = Look.SWEEP, start

    def insist(self) -> None:
        """Go on with a sweep that something else had taken the nose from."""
        if self.look is not Look.SWEEP:
            self.look = Look.SWEEP

    def watch(self, north: float, east: float) -> None:
        """Keep the nose on a point of the world's NED."""
        self.look, self._point = Look.POINT, (north, east)

    def along(self, behavior: float, yaw: float) -> None:
        """The default of WP_YAW_BEHAVIOR: 0 keeps the nose where it is, anything else looks where it flies."""
        if behavior == 0:
            self.hold(yaw)
        elif self.look is not Look.ALONG:
            self.look = Look.ALONG
            self._sp.heading(yaw)

    def arrived(self, yaw: float) -> bool:
        """A sweep is over and the nose is there."""
        off = (self._yaw - yaw + math.pi) % (2.0 * math.pi) - math.pi
        return abs(off) <= ARRIVED and abs(self._left) <= ARRIVED

    def update(self, sense: Sense, dt: float) -> None:
        """Once a tick, while the motors run."""
        if self.look is Look.ALONG:
            speed = math.hypot(sense.ref_vn, sense.ref_ve)
            if speed > LOOK_SHARE * self._sp.limit_of("speed"):
                self._sp.heading(math.atan2(sense.ref_ve, sense.ref_vn))
        elif self.look is Look.SWEEP:
            step = min(max(self._left, -self.rate * dt), self.rate * dt)
            self._left -= step
            self._yaw += step
            self._sp.heading(self._yaw)
        elif self.look is Look.POINT:
            north, east = self._point[0] - sense.north, self._point[1] - sense.east
            if math.hypot(north, east) > 0.5:
                self._sp.heading(math.atan2(east, north))
