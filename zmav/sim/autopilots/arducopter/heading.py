"""Where a copter that flies by itself points its nose: ArduCopter's "auto yaw" (WP_YAW_BEHAVIOR, yaw in targets,
regions of interest).
"""

from __future__ import annotations

import enum
import math

from zmav.sim.control.setpoints import SetpointHandle
from zmav.sim.fleets.base import Sense

LOOK_SHARE = 0.05  # of the allowed speed: slower motion does not turn the nose


class Look(enum.Enum):
    FIXED = "fixed"
    ALONG = "along"
    RATE = "rate"
    POINT = "point"


class Heading:
    """One vehicle's auto yaw."""

    def __init__(self, setpoint: SetpointHandle) -> None:
        self._sp = setpoint
        self.look = Look.FIXED
        self._point = (0.0, 0.0)

    def hold(self, yaw: float) -> None:
        """Turn to ``yaw`` (radians) and keep it."""
        self.look = Look.FIXED
        self._sp.heading(yaw)

    def turn(self, rate: float) -> None:
        """Turn at ``rate`` rad/s until told otherwise."""
        self.look = Look.RATE
        self._sp.turn(rate)

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

    def update(self, sense: Sense, dt: float) -> None:
        """Once a tick, while the motors run."""
        if self.look is Look.ALONG:
            speed = math.hypot(sense.ref_vn, sense.ref_ve)
            if speed > LOOK_SHARE * self._sp.limit_of("speed"):
                self._sp.heading(math.atan2(sense.ref_ve, sense.ref_vn))
        elif self.look is Look.POINT:
            north, east = self._point[0] - sense.north, self._point[1] - sense.east
            if math.hypot(north, east) > 0.5:
                self._sp.heading(math.atan2(east, north))
