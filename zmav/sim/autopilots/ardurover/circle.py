"""CIRCLE: round a place, first to the edge and then along it. Also what LOITER_TURNS is in a mission.

https://ardupilot.org/rover/docs/circle-mode.html
"""

from __future__ import annotations

import math

from zmav.rotation import wrap
from zmav.sim.autopilots.ardurover.modes import RoverMode
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

WARNING = 4
RADIUS_MIN = 0.1
ON_TRACK_M = 0.2
SLOWER = 0.8
GRAVITY = 9.80665


class Circle(RoverMode):
    """``angle`` rad gone round so far."""

    number, name, autopilot, changes_speed = 9, "CIRCLE", True, True
    _centre: Point = (0.0, 0.0)
    _radius = 1.0
    _clockwise = True
    _yaw = _pace = _speed = 0.0
    _edge = _back = False
    angle = 0.0

    def enter(self) -> None:
        params = self.rover.params
        self.around(self.rover.travel.here, abs(params["CIRC_RADIUS"]), int(params["CIRC_DIR"]) != 1)
        self._yaw = self.rover.sense.yaw

    def around(self, centre: Point, radius: float, clockwise: bool) -> None:
        """Begin a circle."""
        rover, params = self.rover, self.rover.params
        self._centre, self._clockwise = centre, clockwise
        self._radius = max(radius, RADIUS_MIN)
        if self._radius < params["TURN_RADIUS"]:
            self._radius = params["TURN_RADIUS"]
            rover.say(WARNING, f"Circle: radius increased to TURN_RADIUS ({self._radius:4.1f})")
        self._speed = params["CIRC_SPEED"] if params["CIRC_SPEED"] > 0 else params["WP_SPEED"]
        self._check_speed()
        self._edge = self._back = False
        self._pace = self.angle = 0.0
        self._aim_from_here()
        rover.sp.back(False)

    def _check_speed(self) -> None:
        most = math.sqrt(max(self.rover.params["ATC_TURN_MAX_G"], 0.0) * GRAVITY * self._radius)
        if self._speed > most:
            self._speed = most
            self.rover.say(WARNING, f"Circle: max speed is {most:4.1f}")

    def _aim_from_here(self) -> None:
        north, east = self.rover.travel.here
        off = (north - self._centre[0], east - self._centre[1])
        self._yaw = math.atan2(off[1], off[0]) if math.hypot(*off) > 1e-6 else self.rover.sense.yaw

    def set_speed(self, speed: float) -> bool:
        if not speed > 0.0:
            return False
        self._speed = speed
        self._check_speed()
        return True

    @property
    def _point(self) -> Point:
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        return self._centre[0] + self._radius * c, self._centre[1] + self._radius * s

    @property
    def place(self) -> Vector | None:
        return self.at(self._point)

    @property
    def distance(self) -> float:
        return math.dist(self._point, self.rover.travel.here)

    @property
    def bearing(self) -> float:
        north, east = self.rover.travel.here
        return math.atan2(self._point[1] - east, self._point[0] - north)

    def update(self) -> None:
        rover, params = self.rover, self.rover.params
        travel = rover.travel
        rover.sp.limits(self._speed, travel.acceleration, travel.jerk)
        off = abs(math.dist(self._centre, travel.here) - self._radius)
        near = max(params["TURN_RADIUS"], ON_TRACK_M)
        if not self._edge:
            self._edge = off <= near
            rover.sp.go(self._point)
        elif off > 2.0 * near and not self._back:
            self._speed *= SLOWER
            rover.say(WARNING, f"Circle: cannot keep up, slowing to {self._speed:.1f}m/s")
            self._back = True
        elif off < near and self._back:
            self._back = False
        else:
            self._go_round()

    def _go_round(self) -> None:
        rover = self.rover
        step = 0.5 * rover.travel.acceleration * rover.dt
        change = min(max(self._speed - self._pace, -step), step)
        self._pace += change
        way = 1.0 if self._clockwise else -1.0
        if self._back:
            self._aim_from_here()
        else:
            turned = way * self._pace / self._radius * rover.dt
            self._yaw = wrap(self._yaw + turned)
            self.angle += abs(turned)
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        inward, along = -(self._pace**2) / self._radius, change / rover.dt
        rover.sp.follow(
            self._point,
            (-s * way * self._pace, c * way * self._pace),
            (inward * c - along * way * s, inward * s + along * way * c),
        )
