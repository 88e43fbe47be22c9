"""ORBIT: flies round a point, once MAV_CMD_DO_ORBIT has said which.

https://docs.px4.io/v1.16/en/flight_modes_mc/orbit.html. It goes to the circle by the shortest way first, and is limited
in radius (MC_ORBIT_RAD_MAX) and in centripetal acceleration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

LEAST_M, HIGHEST_MPS, HIGHEST_ACCEL = 1.0, 10.0, 2.0
AWAY_M = 3.0  # farther from the circle than that it approaches first
TO_CENTRE, AS_BEFORE, UNCONTROLLED, TANGENT, BY_STICKS = range(5)  # ORBIT_YAW_BEHAVIOUR


class Orbit:
    """One vehicle's circle; ``radius`` is negative for anticlockwise, seen from above."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self.centre: Vector = (0.0, 0.0, 0.0)
        self.radius, self.speed = LEAST_M, 1.0
        self.yaw_behaviour = TO_CENTRE
        self._angle: float | None = None
        self._yaw = 0.0

    def ask(self, centre: Vector, radius: float | None, speed: float | None, behaviour: int | None) -> None:
        """What DO_ORBIT says; None is left as it is, or as it is by default."""
        p = self._copter.params
        wanted = self.radius if radius is None else radius
        size = min(max(abs(wanted), LEAST_M), max(p["MC_ORBIT_RAD_MAX"], LEAST_M))
        self.radius = math.copysign(size, wanted)
        fastest = min(HIGHEST_MPS, math.sqrt(HIGHEST_ACCEL * size))
        fast = self.speed if speed is None else speed
        # A negative speed turns the circle round.
        self.radius *= math.copysign(1.0, fast)
        self.speed = min(abs(fast), fastest)
        self.centre = centre
        chosen = int(p["MC_ORBIT_YAW_MOD"]) if behaviour is None else behaviour
        self.yaw_behaviour = chosen if TO_CENTRE <= chosen <= BY_STICKS else TO_CENTRE
        self._yaw = self._copter.sense.yaw

    def begin(self) -> None:
        """The mode is entered: the circle is about where the vehicle stands, until it is told otherwise."""
        sense = self._copter.sense
        self._angle = None
        self.ask((sense.north, sense.east, sense.down), None, None, None)

    def fly(self) -> None:
        """One tick."""
        copter, sense = self._copter, self._copter.sense
        north, east = sense.north - self.centre[0], sense.east - self.centre[1]
        size, away = abs(self.radius), math.hypot(north, east)
        bearing = math.atan2(east, north) if away > 0.1 else sense.yaw
        if abs(away - size) > AWAY_M or (self._angle is None and abs(away - size) > 0.5):
            self._angle = None
            copter.sp.raw(False)
            copter.sp.move(pos=self._at(bearing))
        else:
            # From where the vehicle is, not from where it should be: what holds it up does not make it jump.
            self._angle = bearing
            along = math.copysign(self.speed, self.radius)
            vel = (-along * math.sin(self._angle), along * math.cos(self._angle), 0.0)
            inward = -self.speed * self.speed / size
            acc = (inward * math.cos(self._angle), inward * math.sin(self._angle), 0.0)
            copter.sp.raw(True)
            copter.sp.limit("speed", max(self.speed * 1.5, 1.0))
            copter.sp.move(pos=self._at(self._angle), vel=vel, acc=acc)
        self._head(bearing)

    def _at(self, angle: float) -> Vector:
        size = abs(self.radius)
        return (
            self.centre[0] + size * math.cos(angle),
            self.centre[1] + size * math.sin(angle),
            self.centre[2],
        )

    def _head(self, bearing: float) -> None:
        sp = self._copter.sp
        if self.yaw_behaviour == TO_CENTRE:
            sp.heading(bearing + math.pi)
        elif self.yaw_behaviour == TANGENT:
            sp.heading(bearing + math.copysign(math.pi / 2, self.radius))
        else:
            sp.heading(self._yaw)
