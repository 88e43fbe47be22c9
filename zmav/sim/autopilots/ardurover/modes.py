"""ArduRover's modes, except AUTO (in :mod:`.auto`): one object per mode and vehicle.

Modes: https://ardupilot.org/rover/docs/rover-control-modes.html
"""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.state import INFO, WARNING, Doing, GuidedMode, Mode, Target
from zmav.sim.autopilots.ardurover.base import RoverBase
from zmav.sim.autopilots.ardurover.travel import Travel
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

FORWARD_OR_BACK, BACK = 0, 2  # LOIT_TYPE
TIMEOUT_S = 3.0
THERE_M = 0.01  # of the moving point to its place
GONE_QUIET = "target not received last 3secs, stopping"


class RoverMode(Mode):
    """What every mode of a rover tells of itself."""

    armable = True
    autopilot: ClassVar[bool] = False
    """it drives by itself"""
    by_stick: ClassVar[bool] = False
    """the sticks steer"""
    stabilises: ClassVar[bool] = True
    """turn rate or heading are controlled"""

    def __init__(self, rover: RoverBase, travel: Travel) -> None:
        super().__init__(rover)
        self.rover, self.travel = rover, travel

    @property
    def place(self) -> Vector | None:
        """The place that it drives to, in the world's NED."""
        return None

    @property
    def distance(self) -> float:
        """To that place, m."""
        return 0.0 if self.place is None else math.dist(self.place[:2], self.rover.here)

    @property
    def bearing(self) -> float:
        """To that place, rad."""
        here, place = self.rover.here, self.place
        return 0.0 if place is None else math.atan2(place[1] - here[1], place[0] - here[0])

    @property
    def cross_track(self) -> float:
        """Metres off the way there."""
        return 0.0

    def set_speed(self, speed: float) -> bool:
        """Drive at another speed, m/s; False where the mode has none to choose."""
        return False

    def on_arming(self) -> None:
        """It goes on with what it has."""

    def idle(self) -> None:
        """A rover that is not armed does all but turn its motors."""
        self.update()

    def at(self, place: Point) -> Vector:
        return place[0], place[1], self.rover.sense.down


class Initialising(RoverMode):
    """Before the boot is over."""

    number, name, needs_position, armable, by_stick = 16, "INITIALISING", False, False, True
    stabilises = False

    def blocked(self) -> str:
        return "it is for the boot only"

    def update(self) -> None:
        self.rover.sp.coast()


class Manual(RoverMode):
    number, name, needs_position, by_stick, stabilises = 0, "MANUAL", False, True, False

    def update(self) -> None:
        steering, throttle = self.rover.sticks()
        # The wheels go where the stick does, backwards too.
        turned = -steering if throttle < 0.0 else steering
        self.rover.sp.direct(turned, throttle)


class Hold(RoverMode):
    number, name, needs_position, stabilises = 4, "HOLD", False, False

    def update(self) -> None:
        self.rover.sp.coast()


class Loiter(RoverMode):
    """Stays within LOIT_RADIUS of a place, and drives back when it is moved out of it."""

    number, name, autopilot = 5, "LOITER", True
    _place: Point = (0.0, 0.0)
    _yaw = 0.0

    def enter(self) -> None:
        self._place = self.travel.stopping_place()
        self._yaw = self.rover.sense.yaw

    @property
    def place(self) -> Vector | None:
        return self.at(self._place)

    def update(self) -> None:
        rover, params = self.rover, self.rover.params
        beyond = self.distance - params["LOIT_RADIUS"]
        if beyond <= 0.0:
            rover.sp.head(self._yaw, 0.0)
            return
        speed = min(beyond * params["LOIT_SPEED_GAIN"], params["WP_SPEED"])
        north, east = rover.here
        self._yaw = math.atan2(self._place[1] - east, self._place[0] - north)
        off = math.remainder(self._yaw - rover.sense.yaw, math.tau)
        kind = int(params["LOIT_TYPE"])
        if kind == BACK or (kind == FORWARD_OR_BACK and abs(off) > math.pi / 2.0):
            self._yaw = math.remainder(self._yaw + math.pi, math.tau)
            off, speed = math.remainder(self._yaw - rover.sense.yaw, math.tau), -speed
        # Slower while the nose is off: three quarters at 45 degrees, half at 90.
        speed *= 1.0 - 0.5 * min(abs(off) / (math.pi / 2.0), 1.0)
        rover.sp.head(self._yaw, speed)


class Rtl(RoverMode):
    """Straight to the nearest rally point or home."""

    number, name, armable, autopilot, changes_speed = 11, "RTL", False, True, True
    _told = False

    def blocked(self) -> str:
        return "" if self.rover.boot.has("origin") else "there is no home"

    def enter(self) -> None:
        north, east, _ = self.rover.rally.nearest()
        self.travel.begin(max(self.rover.params["RTL_SPEED"], 0.0))
        self.travel.go((north, east))
        self._told = False

    @property
    def reached(self) -> bool:
        return self.travel.reached

    @property
    def place(self) -> Vector | None:
        place = self.travel.destination
        return None if place is None else self.at(place)

    @property
    def cross_track(self) -> float:
        return self.travel.cross_track

    def set_speed(self, speed: float) -> bool:
        return self.travel.change_speed(speed)

    def update(self) -> None:
        rover = self.rover
        if not self.travel.reached:
            self.travel.update()
            return
        if not self._told:
            self._told = True
            rover.say(INFO, "Reached destination")
        rover.sp.stop()


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
