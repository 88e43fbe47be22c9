"""CIRCLE: round a point ahead, nose toward it. https://ardupilot.org/copter/docs/circle-mode.html"""

from __future__ import annotations

import math

from zmav.sim.autopilots.arducopter.modes import CENTI, AltHold
from zmav.sim.control.setpoints import Axis

BY_PILOT, NOSE_AHEAD, AROUND_HERE = 1, 2, 4  # CIRCLE_OPTIONS
LEAST_SPIN_UP = math.radians(2.0)  # rad/s^2
FASTEST = math.radians(90.0)


class Circle(AltHold):
    """The pilot's pitch stick makes it smaller or wider, roll faster or slower, throttle higher or lower."""

    number, name = 7, "CIRCLE"
    armable = False
    by_pilot = False
    needs_position = True

    def enter(self) -> None:
        copter, s = self.copter, self.copter.sense
        self._radius = max(copter.params["CIRCLE_RADIUS"] * CENTI, 0.0)
        self._rate = math.radians(copter.params["CIRCLE_RATE"])  # asked for
        self._speed = 0.0  # rad/s now
        brake = max(copter.sp.limit_of("accel"), 0.1)
        ahead = 0.5 * math.hypot(s.vn, s.ve) / brake
        north, east = s.north + s.vn * ahead, s.east + s.ve * ahead
        self._angle = s.yaw + math.pi
        if not self._option(AROUND_HERE):
            north += self._radius * math.cos(s.yaw)
            east += self._radius * math.sin(s.yaw)
        self._centre = (north, east)
        copter.heading.watch(north, east)

    def leave(self) -> None:
        self.copter.sp.raw(False)

    def _option(self, bit: int) -> bool:
        return bool(int(self.copter.params["CIRCLE_OPTIONS"]) & bit)

    def update(self) -> None:
        copter, pilot, dt = self.copter, self.copter.rc, self.copter.dt
        if not copter.spool():
            return
        if self._option(BY_PILOT) and pilot.valid:
            self._radius = max(self._radius - pilot.pitch * copter.speeds["speed"] * dt, 0.0)
            low, high = (-FASTEST, 0.0) if self._rate < 0.0 else (0.0, FASTEST)
            self._rate = min(max(self._rate + math.radians(pilot.roll * dt), low), high)
        self._turn(dt)
        radius, speed = self._radius, self._speed
        cos, sin = math.cos(self._angle), math.sin(self._angle)
        along, inward = radius * speed, -radius * speed * speed
        copter.sp.move(
            pos=(self._centre[0] + radius * cos, self._centre[1] + radius * sin, 0.0),
            vel=(-along * sin, along * cos, 0.0),
            acc=(inward * cos, inward * sin, 0.0),
            vertical=Axis.VELOCITY,
        )
        up = copter.params["PILOT_SPEED_UP"] * CENTI
        down = copter.params["PILOT_SPEED_DN"] * CENTI or up
        climb = pilot.climb if pilot.valid else 0.0
        copter.sp.climb(-climb * (up if climb > 0 else down))
        if self._option(NOSE_AHEAD):
            copter.heading.hold(self._angle + math.copysign(math.pi / 2.0, self._rate))

    def _turn(self, dt: float) -> None:
        """As fast as asked, and as speed and acceleration allow, reached within a second."""
        copter = self.copter
        fastest = FASTEST
        if self._radius > 1e-3:
            accel = max(copter.sp.limit_of("accel"), 0.1)
            fastest = min(copter.speeds["speed"], math.sqrt(0.5 * accel * self._radius)) / self._radius
        wanted = min(max(self._rate, -fastest), fastest)
        step = max(fastest, LEAST_SPIN_UP) * dt
        self._speed += min(max(wanted - self._speed, -step), step)
        self._angle += self._speed * dt
