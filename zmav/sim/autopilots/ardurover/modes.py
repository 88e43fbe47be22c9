"""ArduRover's modes, except GUIDED and AUTO (in :mod:`.guided`, :mod:`.auto`): one object per mode and vehicle.

Modes: https://ardupilot.org/rover/docs/rover-control-modes.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from zmav.rotation import wrap
from zmav.sim.autopilots.ardupilot.mode import Mode
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardurover.rover import ArduRover

NOTICE, INFO = 5, 6
GRAVITY = 9.80665
TURN_RADIUS_MIN, LATERAL_MIN = 0.1, 0.1
INITIAL_HEADING = 0  # SIMPLE_TYPE
FORWARD_OR_BACK, FORWARD, BACK = 0, 1, 2  # LOIT_TYPE


class RoverMode(Mode):
    """What every mode of a rover tells of itself."""

    vehicle: ArduRover
    armable = True
    autopilot: ClassVar[bool] = False
    """it drives by itself"""
    by_stick: ClassVar[bool] = False
    """the sticks steer"""
    stabilises: ClassVar[bool] = True
    """turn rate or heading are controlled"""

    @property
    def rover(self) -> ArduRover:
        return self.vehicle

    @property
    def guided(self) -> bool:
        """Somebody outside may steer."""
        return False

    @property
    def place(self) -> Vector | None:
        """The place that it drives to, in the world's NED."""
        return None

    @property
    def distance(self) -> float:
        """To that place, m."""
        return 0.0

    @property
    def bearing(self) -> float:
        """To that place, rad."""
        return 0.0

    @property
    def cross_track(self) -> float:
        """Metres off the way there."""
        return 0.0

    def set_speed(self, speed: float) -> bool:
        """Drive at another speed, m/s; False where the mode has none to choose."""
        return False

    def blocked(self) -> str:
        """Why it is not entered, armed or not; empty: it is."""
        return ""

    def on_arming(self) -> None:
        """It goes on with what it has."""

    def idle(self) -> None:
        """A rover that is not armed does all but turn its motors."""
        self.update()

    def at(self, place: Point) -> Vector:
        return place[0], place[1], self.vehicle.sense.down


class Initialising(RoverMode):
    """Before the boot is over."""

    number, name, needs_position, armable, by_stick = 16, "INITIALISING", False, False, True
    stabilises = False

    def blocked(self) -> str:
        return "it is for the boot only"

    def update(self) -> None:
        self.rover.sp.coast()


class Unbuilt(RoverMode):
    """A mode that exists and cannot be entered; ``why`` is said, where the real one says something."""

    why: ClassVar[str] = ""

    def blocked(self) -> str:
        if self.why:
            self.rover.say(NOTICE, self.why)
        return "it finds nothing to do"

    def update(self) -> None:
        self.rover.sp.coast()


class Follow(Unbuilt):
    number, name = 6, "FOLLOW"


class Dock(Unbuilt):
    number, name, why = 8, "DOCK", "Dock: target not acquired"


class Manual(RoverMode):
    number, name, needs_position, by_stick, stabilises = 0, "MANUAL", False, True, False

    def update(self) -> None:
        steering, throttle = self.rover.sticks()
        expo = min(max(self.rover.params["MANUAL_STR_EXPO"], 0.0), 0.95)
        steering = (1.0 - expo) * steering + expo * steering**3
        # The wheels go where the stick does, backwards too.
        turned = -steering if throttle < 0.0 and not self.rover.frame.skid else steering
        self.rover.sp.direct(turned, throttle, scaled=bool(int(self.rover.params["MANUAL_OPTIONS"]) & 1))


class Acro(RoverMode):
    number, name, needs_position, by_stick = 1, "ACRO", False, True

    def update(self) -> None:
        rover = self.rover
        steering, throttle = rover.sticks()
        rate = steering * math.radians(rover.params["ACRO_TURN_RATE"])
        rover.sp.turn(rate, throttle * rover.fastest)


class Steering(RoverMode):
    number, name, needs_position, by_stick = 3, "STEERING", False, True

    def update(self) -> None:
        rover, params = self.rover, self.rover.params
        steering, throttle = rover.sticks()
        speed = throttle * rover.fastest
        if rover.frame.skid and speed == 0.0:
            rover.sp.turn(steering * math.radians(params["ACRO_TURN_RATE"]), 0.0)
            return
        ahead = rover.speed_ahead
        most = ahead * ahead / max(params["TURN_RADIUS"], TURN_RADIUS_MIN)
        most = min(max(most, LATERAL_MIN), max(params["ATC_TURN_MAX_G"], 0.0) * GRAVITY)
        lateral = most * steering * (-1.0 if speed < 0.0 else 1.0)
        rover.sp.turn(lateral / math.copysign(max(abs(ahead), 1.0), ahead), speed)


class Hold(RoverMode):
    number, name, needs_position, stabilises = 4, "HOLD", False, False

    def update(self) -> None:
        self.rover.sp.coast()


class Simple(RoverMode):
    """Drives where the sticks point, as seen by who stands behind the place where it was armed."""

    number, name, needs_position = 7, "SIMPLE", False
    _start = _yaw = 0.0

    def face(self) -> None:
        """Ahead is where the nose is now."""
        self._start = self._yaw = self.rover.sense.yaw

    def update(self) -> None:
        rover = self.rover
        right, up = rover.raw_sticks()
        reach = min(math.hypot(right, up), 1.0)
        if reach > 0.0:
            start = self._start if int(rover.params["SIMPLE_TYPE"]) == INITIAL_HEADING else 0.0
            self._yaw = wrap(start + math.atan2(right, up))
        rover.sp.head(self._yaw, reach * rover.fastest)


class Loiter(RoverMode):
    """Stays within LOIT_RADIUS of a place, and drives back when it is moved out of it."""

    number, name, autopilot = 5, "LOITER", True
    _place: Point = (0.0, 0.0)
    _yaw = 0.0

    def enter(self) -> None:
        self._place = self.rover.travel.stopping_place()
        self._yaw = self.rover.sense.yaw

    @property
    def place(self) -> Vector | None:
        return self.at(self._place)

    @property
    def distance(self) -> float:
        return math.dist(self._place, self.rover.travel.here)

    def update(self) -> None:
        rover, params = self.rover, self.rover.params
        beyond = self.distance - params["LOIT_RADIUS"]
        if beyond <= 0.0:
            rover.sp.head(self._yaw, 0.0)
            return
        speed = min(beyond * params["LOIT_SPEED_GAIN"], params["WP_SPEED"])
        north, east = rover.travel.here
        self._yaw = math.atan2(self._place[1] - east, self._place[0] - north)
        off = wrap(self._yaw - rover.sense.yaw)
        kind = int(params["LOIT_TYPE"])
        if kind == BACK or (kind == FORWARD_OR_BACK and abs(off) > math.pi / 2.0):
            self._yaw = wrap(self._yaw + math.pi)
            off, speed = wrap(self._yaw - rover.sense.yaw), -speed
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
        self.rover.travel.begin(max(self.rover.params["RTL_SPEED"], 0.0))
        self.rover.travel.go((north, east))
        self._told = False

    @property
    def reached(self) -> bool:
        return self.rover.travel.reached

    @property
    def place(self) -> Vector | None:
        place = self.rover.travel.destination
        return None if place is None else self.at(place)

    @property
    def distance(self) -> float:
        return self.rover.travel.distance

    @property
    def bearing(self) -> float:
        return self.rover.travel.bearing

    @property
    def cross_track(self) -> float:
        return self.rover.travel.cross_track

    def set_speed(self, speed: float) -> bool:
        return self.rover.travel.change_speed(speed)

    def update(self) -> None:
        rover = self.rover
        if not rover.travel.reached:
            rover.travel.update()
            return
        if not self._told:
            self._told = True
            rover.say(INFO, "Reached destination")
        rover.stop()


class SmartRtl(Rtl):
    """Back along its own track."""

    number, name = 12, "SMART_RTL"
    _home = False

    def blocked(self) -> str:
        return "" if self.rover.boot.has("origin") and self.rover.track.usable else "there is no track"

    def enter(self) -> None:
        self._points = self.rover.track.way_back()
        self._home = self._told = False
        self.rover.travel.begin(max(self.rover.params["RTL_SPEED"], 0.0))
        self._next()

    @property
    def reached(self) -> bool:
        return self._home

    @property
    def place(self) -> Vector | None:
        return None if self._home else super().place

    def _next(self) -> None:
        if not self._points:
            self._home = True
            return
        place = self._points.pop(0)
        self.rover.travel.go(place, self._points[0] if self._points else None)

    def update(self) -> None:
        rover = self.rover
        if not self._home:
            rover.travel.update()
            if rover.travel.reached:
                self._next()
            return
        if not self._told:
            self._told = True
            rover.say(INFO, "Reached destination")
        rover.stop()
