"""Flying from one place to the next, as ArduCopter's waypoint navigation does: straight, and through a corner without
stopping where the way goes on.

A place with a way on counts as reached where the turn into the next leg begins; the turn passes it within
WPNAV_RADIUS. Any other is reached once the copter has come to rest within WPNAV_RADIUS of it.
Source: ardupilot.org, "Mission Planning" and "Waypoint navigation (S-curves)".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.control.setpoints import Axis, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter import ArduCopter

AT_REST = 0.5  # m/s
SHORTEST_LEG_M = 0.1
CENTI = 0.01


class Travel:
    """One vehicle's way to a place."""

    def __init__(self, copter: ArduCopter) -> None:
        self._copter = copter
        self.destination: Vector = (0.0, 0.0, 0.0)
        self.reached = True
        self.paused = False
        self._onward: Vector | None = None
        self._start: Vector = (0.0, 0.0, 0.0)

    def go(self, destination: Vector, onward: Vector | None = None) -> None:
        """Fly to ``destination`` (the world's NED), and not stop there where there is a place to go ``onward`` to."""
        s = self._copter.sense
        self._start = (s.north, s.east, s.down)
        self.destination, self._onward = destination, onward
        self.reached = self.paused = False
        self._hold_line()
        self._copter.sp.move(pos=destination)

    def stop(self) -> None:
        """Stay at the place where the copter can stop."""
        s = self._copter.sense
        brake = max(self._copter.sp.limit_of("accel"), 0.1)
        ahead = 0.5 * math.hypot(s.vn, s.ve) / brake
        self.go((s.north + s.vn * ahead, s.east + s.ve * ahead, s.down))

    @property
    def distance(self) -> float:
        """To the destination over the ground, m."""
        s, d = self._copter.sense, self.destination
        return math.hypot(d[0] - s.north, d[1] - s.east)

    @property
    def bearing(self) -> float:
        s, d = self._copter.sense, self.destination
        return math.atan2(d[1] - s.east, d[0] - s.north)

    def pause(self) -> None:
        self.paused = True
        self._copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)

    def resume(self) -> None:
        if self.paused:
            self.paused = False
            self._copter.sp.move(pos=self.destination)

    def update(self) -> None:
        """Once a tick: see whether it is there."""
        if self.reached or self.paused:
            return
        s = self._copter.sense
        radius = self._copter.params["WPNAV_RADIUS"] * CENTI
        if self._onward is not None:
            height = abs(self.destination[2] - s.down)
            self.reached = self.distance <= self._turning(radius) and height <= max(radius, 1.0)
            return
        away = math.hypot(self.distance, self.destination[2] - s.down)
        self.reached = away <= radius and math.hypot(s.ref_vn, s.ref_ve) < AT_REST and abs(s.vd) < AT_REST

    def _turning(self, radius: float) -> float:
        """How far before the corner the turn begins: on a circle that passes the corner at ``radius``."""
        onward = self._onward
        assert onward is not None
        a, b, c = self._start, self.destination, onward
        before = math.atan2(b[1] - a[1], b[0] - a[0])
        after = math.atan2(c[1] - b[1], c[0] - b[0])
        half = 0.5 * abs((after - before + math.pi) % (2.0 * math.pi) - math.pi)
        speed = self._copter.sp.limit_of("speed")
        widest = speed * speed / max(self._copter.sp.limit_of("accel"), 0.1)
        if half > math.radians(80.0):
            return radius
        bend = min(radius / max(1.0 / math.cos(half) - 1.0, 1e-3), widest)
        legs = 0.5 * min(math.dist(a, b), math.dist(b, c))
        return min(max(bend * math.tan(half), radius), max(legs, radius))

    def _hold_line(self) -> None:
        """Choose the speeds so that height and ground are covered together."""
        copter, speeds = self._copter, self._copter.speeds
        ground = math.dist(self._start[:2], self.destination[:2])
        climb = self._start[2] - self.destination[2]
        speed, vertical = speeds["speed"], speeds["speed_up" if climb > 0 else "speed_down"]
        name = "speed_up" if climb > 0 else "speed_down"
        for each in speeds:
            copter.sp.limit(each, speeds[each])
        if ground < SHORTEST_LEG_M or abs(climb) < SHORTEST_LEG_M:
            return
        if abs(climb) / vertical > ground / speed:
            copter.sp.limit("speed", vertical * ground / abs(climb))
        else:
            copter.sp.limit(name, max(speed * abs(climb) / ground, 0.1))
