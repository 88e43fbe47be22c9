"""GUIDED: drives to what the ground or a companion asks, as ArduRover does.

Targets: https://ardupilot.org/dev/docs/mavlink-rover-commands.html. A place holds for ever; headings, turn rates and
speeds are dropped three seconds after the last one, and the rover stops.
"""

from __future__ import annotations

import math

from zmav.rotation import wrap
from zmav.sim.autopilots.ardupilot.targets import AttitudeTarget, Doing, Target
from zmav.sim.autopilots.ardupilot.vehicle import WARNING, GuidedMode
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
    _started: tuple[float, Point] = (0.0, (0.0, 0.0))
    _limits: tuple[float, float] = (0.0, 0.0)

    def enter(self) -> None:
        self.doing = Doing.HOLD
        self.rover.travel.begin()

    def hold(self) -> None:
        self.doing = Doing.HOLD

    # ---- orders

    def go(self, place: Point) -> None:
        """Drive to a place (north and east in the world) and stay there."""
        travel = self.rover.travel
        if self.doing is not Doing.POSITION:
            self.rover.sp.stop()  # so that the moving point begins where the rover is
        self.doing, self._place, self._reached, self._told = Doing.POSITION, place, False, False
        travel.destination = place
        travel.turn_first(place)

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

    def lean(self, target: AttitudeTarget) -> None:
        """The thrust is a share of WP_SPEED; the heading is the attitude's, unless there is none."""
        speed = self.rover.params["WP_SPEED"] * min(max(target.thrust or 0.0, -1.0), 1.0)
        if target.attitude is None:
            self.turn(target.rates[2], speed)
        else:
            w, x, y, z = target.attitude
            self.head(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)), speed)

    # ---- what a mission adds

    def limit(self, seconds: float, metres: float) -> None:
        """How long and how far a mission lets others steer; 0: no limit."""
        self._limits = (seconds, metres)

    def begin_limits(self) -> None:
        self._started = (self.rover.now, self.rover.travel.here)

    @property
    def limits_breached(self) -> bool:
        seconds, metres = self._limits
        since, place = self._started
        too_long = seconds > 0.0 and self.rover.now - since >= seconds
        return too_long or (metres > 0.0 and math.dist(place, self.rover.travel.here) > metres)

    # ---- what it tells

    @property
    def guided(self) -> bool:
        return True

    @property
    def place(self) -> Vector | None:
        return self.at(self._place) if self.doing is Doing.POSITION else None

    @property
    def distance(self) -> float:
        return math.dist(self._place, self.rover.travel.here) if self.doing is Doing.POSITION else 0.0

    @property
    def bearing(self) -> float:
        return self.rover.travel.bearing if self.doing is Doing.POSITION else 0.0

    def set_speed(self, speed: float) -> bool:
        return self.doing is Doing.POSITION and self.rover.travel.change_speed(speed)

    # ---- driving

    def update(self) -> None:
        if self.doing is Doing.POSITION:
            self._go_on()
        elif self.doing is Doing.VELOCITY:
            self._drive()
        else:
            self.rover.stop()

    def _go_on(self) -> None:
        rover, travel = self.rover, self.rover.travel
        if self._reached:
            if not self._told:
                self._told = True
                rover.reached(0)
            rover.stop()
            return
        if travel.pivots():
            return
        travel.ready()
        rover.sp.go(self._place)
        led = math.dist(rover.seen_point(), self._place) < THERE_M
        self._reached = led and self.distance < rover.params["WP_RADIUS"]

    def _drive(self) -> None:
        rover = self.rover
        if rover.now - self._heard > TIMEOUT_S:
            if self._heard > -math.inf:
                self._heard = -math.inf
                rover.say(WARNING, GONE_QUIET)
            rover.stop()
            return
        speed = rover.nudged(self._speed)
        rover.sp.back(False)
        if self._turning:
            rover.sp.turn(self._rate, speed)
        else:
            rover.sp.head(wrap(self._yaw), speed)
