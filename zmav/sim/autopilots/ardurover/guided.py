"""GUIDED: drives to what the ground or a companion asks, as ArduRover does.

Targets: https://ardupilot.org/dev/docs/mavlink-rover-commands.html. A place holds for ever; headings, turn rates and
speeds are dropped three seconds after the last one, and the rover stops.
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.ardupilot.state import WARNING, GuidedMode
from zmav.sim.autopilots.ardupilot.targets import Doing, Target
from zmav.sim.autopilots.ardurover.modes import RoverMode
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

TIMEOUT_S = 3.0
THERE_M = 0.01  # of the moving point to its place
GONE_QUIET = "target not received last 3secs, stopping"


class Guided(RoverMode, GuidedMode):
    number, name, autopilot, changes_speed = 15, "GUIDED", True, True

    _place: Point = (0.0, 0.0)
    _reached = _told = False
    _yaw = _rate = _speed = 0.0
    _turning = False
    _heard = -math.inf

    def enter(self) -> None:
        self.doing = Doing.HOLD
        self.travel.begin()

    # ---- orders

    def go(self, place: Point) -> None:
        """Drive to a place (north and east in the world) and stay there."""
        travel = self.travel
        if self.doing is not Doing.POSITION:
            self.rover.sp.stop()  # so that the moving point begins where the rover is
        self.doing, self._place, self._reached, self._told = Doing.POSITION, place, False, False
        travel.destination = place

    def head(self, yaw: float, speed: float) -> None:
        """Drive on a heading."""
        self.doing, self._turning, self._yaw, self._speed = Doing.VELOCITY, False, yaw, speed
        self._heard = self.rover.now

    def turn(self, rate: float, speed: float) -> None:
        """Drive and turn."""
        self.doing, self._turning, self._rate, self._speed = Doing.VELOCITY, True, rate, speed
        self._heard = self.rover.now

    def aim(self, target: Target) -> None:
        if target.pos is not None:
            self.go((target.pos[0], target.pos[1]))
        elif target.vel is not None:
            self.head(math.atan2(target.vel[1], target.vel[0]), math.hypot(target.vel[0], target.vel[1]))

    # ---- what it tells

    @property
    def place(self) -> Vector | None:
        return self.at(self._place) if self.doing is Doing.POSITION else None

    def set_speed(self, speed: float) -> bool:
        return self.doing is Doing.POSITION and self.travel.change_speed(speed)

    # ---- driving

    def update(self) -> None:
        if self.doing is Doing.POSITION:
            self._go_on()
        elif self.doing is Doing.VELOCITY:
            self._drive()
        else:
            self.rover.sp.stop()

    def _go_on(self) -> None:
        rover, travel = self.rover, self.travel
        if self._reached:
            if not self._told:
                self._told = True
                rover.reached(0)
            rover.sp.stop()
            return
        travel.ready()
        rover.sp.go(self._place)
        led = math.dist(rover.sp.point(), self._place) < THERE_M
        self._reached = led and self.distance < rover.params["WP_RADIUS"]

    def _drive(self) -> None:
        rover = self.rover
        if rover.now - self._heard > TIMEOUT_S:
            if self._heard > -math.inf:
                self._heard = -math.inf
                rover.say(WARNING, GONE_QUIET)
            rover.sp.stop()
            return
        speed = self._speed
        if self._turning:
            rover.sp.turn(self._rate, speed)
        else:
            rover.sp.head(math.remainder(self._yaw, math.tau), speed)
