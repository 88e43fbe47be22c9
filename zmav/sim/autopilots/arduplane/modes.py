"""ArduPlane's flight modes, except AUTO and AUTOLAND: one object per mode and vehicle.

Modes: https://ardupilot.org/plane/docs/flight-modes.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.state import INFO, Doing, GuidedMode, Mode, Target
from zmav.sim.autopilots.arduplane.base import PlaneBase
from zmav.sim.autopilots.arduplane.landing import Landing
from zmav.sim.autopilots.arduplane.launch import Launch
from zmav.sim.autopilots.arduplane.way import Way

COURSE_SPEED = 5.0  # m/s: from there on the course over the ground is known
FLYING_S = 10.0
TAKEOFF_DONE_M = 2.0
GLIDE = 2  # FS_SHORT_ACTN: fly by wire without power
ATTITUDE_S = 3.0


class PlaneParts(PlaneBase, ABC):
    """A plane with what its modes steer."""

    way: Way
    launch: Launch
    landing: Landing


class PlaneMode(Mode):
    """``fly`` sets the targets, twenty times a second."""

    needs_position: ClassVar[bool] = False
    armable: ClassVar[bool] = True
    throttle_to_arm: ClassVar[float] = 1.0
    auto_throttle: ClassVar[bool] = False
    navigates: ClassVar[bool] = False  # somewhere by itself
    captures_direction: ClassVar[bool] = False  # the first course flown in it is AUTOLAND's

    def __init__(self, plane: PlaneParts) -> None:
        super().__init__(plane)
        self.plane = plane

    def update(self) -> None:
        if self.plane.on_turn:
            self.fly()

    def idle(self) -> None:
        """Disarmed: the surfaces move, the engine does not."""
        if self.plane.on_turn:
            self.rest()
            self.plane.sp.power(0.0)

    def rest(self) -> None:
        """What is held on the ground, disarmed: level."""
        self.plane.sp.roll(0.0)
        self.plane.sp.pitch(0.0)

    @abstractmethod
    def fly(self) -> None:
        """Set this moment's targets."""


class Manual(PlaneMode):
    number, name = 0, "MANUAL"

    def fly(self) -> None:
        plane = self.plane
        plane.sp.surfaces(plane.stick_roll, plane.stick_pitch, plane.stick_yaw)
        plane.sp.power(plane.stick_throttle)

    def rest(self) -> None:
        self.fly()


class Circle(PlaneMode):
    number, name, auto_throttle, navigates = 1, "CIRCLE", True, True

    def enter(self) -> None:
        self._down = self.plane.sense.down
        self.plane.way.stay()

    def fly(self) -> None:
        plane = self.plane
        plane.sp.roll(math.radians(plane.params["ROLL_LIMIT_DEG"]) / 3.0)
        plane.fly_height(-self._down, plane.airspeed_wanted)


class FlyByWireA(PlaneMode):
    number, name, captures_direction = 5, "FBWA", True

    def fly(self) -> None:
        plane, params = self.plane, self.plane.params
        throttle = plane.stick_throttle
        pitch = plane.stick_pitch * math.radians(
            params["PTCH_LIM_MAX_DEG"] if plane.stick_pitch > 0.0 else -params["PTCH_LIM_MIN_DEG"]
        )
        # With little power the nose goes down a bit, so that speed is kept (STAB_PITCH_DOWN).
        cruise = max(params["TRIM_THROTTLE"] * 0.01, 0.01)
        pitch -= math.radians(params["STAB_PITCH_DOWN"]) * max(1.0 - throttle / cruise, 0.0)
        roll = plane.stick_roll * math.radians(params["ROLL_LIMIT_DEG"])
        if plane.rc.lost and int(params["FS_SHORT_ACTN"]) == GLIDE:
            roll, pitch, throttle = 0.0, 0.0, 0.0
        lowest, highest = math.radians(params["PTCH_LIM_MIN_DEG"]), math.radians(params["PTCH_LIM_MAX_DEG"])
        plane.sp.roll(roll)
        plane.sp.pitch(min(max(pitch, lowest), highest))
        plane.sp.yaw(plane.stick_yaw)
        plane.sp.power(throttle)

    def rest(self) -> None:
        self.fly()


class Rtl(PlaneMode):
    number, name, auto_throttle, navigates, armable = 11, "RTL", True, True, False

    def enter(self) -> None:
        plane = self.plane
        place = plane.rally.nearest()
        if place == plane.home_world:
            height = plane.params["RTL_ALTITUDE"]
            place = place[0], place[1], plane.sense.down if height < 0 else place[2] - height
        plane.way.direct(place)

    def fly(self) -> None:
        plane, way = self.plane, self.plane.way
        radius = plane.params["RTL_RADIUS"]
        if radius < 0:
            way.counter_clockwise = True
        way.circle(radius)
        plane.fly_height(-way.down, plane.airspeed_wanted)


class Loiter(PlaneMode):
    number, name, auto_throttle, navigates = 12, "LOITER", True, True

    def enter(self) -> None:
        self.plane.way.stay()

    def fly(self) -> None:
        self.plane.way.circle()
        self.plane.fly_height(-self.plane.way.down, self.plane.airspeed_wanted)


class Takeoff(PlaneMode):
    """Off the ground straight ahead to TKOFF_ALT, then circles about a point TKOFF_DIST away."""

    number, name, auto_throttle, navigates = 13, "TAKEOFF", True, True
    captures_direction = True

    def enter(self) -> None:
        self._climbing, self._set_up = True, False

    @property
    def rising(self) -> bool:
        """It is not there yet."""
        return self._climbing

    def fly(self) -> None:
        plane = self.plane
        if not self._set_up:
            self._set_up = self._prepare()
        if self._climbing and self._set_up:
            gone = math.hypot(plane.here[0] - self._start[0], plane.here[1] - self._start[1])
            if plane.launch.climbed >= plane.params["TKOFF_ALT"] - TAKEOFF_DONE_M or gone >= plane.params["TKOFF_DIST"]:
                self._climbing = False
        if not self._set_up:
            self._roll_out()
        elif self._climbing:
            plane.way.circle()
            plane.launch.climb(-plane.way.end[2])
        else:
            plane.way.circle()
            plane.fly_height(-plane.way.down, plane.airspeed_wanted)

    def _roll_out(self) -> None:
        """Wings level, until it is fast enough for a course."""
        plane = self.plane
        plane.launch.begin(math.radians(plane.params["TKOFF_LVL_PITCH"]))
        plane.launch.climb(-plane.sense.down + plane.params["TKOFF_ALT"])
        plane.sp.roll(0.0)

    def _prepare(self) -> bool:
        """Where to, once it moves: from its course."""
        plane, params, s = self.plane, self.plane.params, self.plane.sense
        height, far, course = params["TKOFF_ALT"], params["TKOFF_DIST"], math.atan2(s.ve, s.vn)
        if plane.flying and plane.now - plane.flying_since > FLYING_S:
            plane.way.stay()
            self._climbing = False
            return True
        if plane.throttle_suppressed or plane.groundspeed <= COURSE_SPEED:
            return False
        self._start = plane.here
        degrees = math.degrees(course) % 360.0
        plane.say(INFO, f"Takeoff to {height:.0f}m for {far:.1f}m heading {degrees:.1f} deg")
        self._aim(course, far, height)
        plane.launch.begin(math.radians(params["TKOFF_LVL_PITCH"]))
        return True

    def _aim(self, course: float, far: float, up: float) -> None:
        here = self.plane.here
        self.plane.way.direct((here[0] + far * math.cos(course), here[1] + far * math.sin(course), here[2] - up))


class Initialising(PlaneMode):
    number, name, auto_throttle, armable = 16, "INITIALISING", True, False

    def fly(self) -> None:
        self.plane.sp.surfaces(0.0, 0.0, 0.0)
        self.plane.sp.power(0.0)

    def rest(self) -> None:
        self.fly()

    def blocked(self) -> str:
        return "only the boot is in it"


class Guided(PlaneMode, GuidedMode):
    number, name, auto_throttle, navigates, changes_speed = 15, "GUIDED", True, True, True

    def enter(self) -> None:
        self.radius = 0.0
        self.doing, self.target = Doing.POSITION, Target()
        self._forced: dict[str, tuple[float, float]] = {}  # roll, pitch or throttle, and until when
        self._told = True
        self.plane.way.stay()

    # ---- what it is told

    def aim(self, target: Target) -> None:
        """Circle about a place from now on."""
        if target.pos is not None:
            self.fly_to(target.pos)

    def fly_to(
        self, place: tuple[float, float, float], radius: float = 0.0, *, counter_clockwise: bool = False
    ) -> None:
        """Circle about ``place``; ``radius`` 0: WP_LOITER_RAD."""
        plane = self.plane
        plane.way.direct(place)
        self.radius = radius
        plane.way.counter_clockwise |= counter_clockwise
        self.target, self._told = Target(pos=place), False

    def force(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        throttle: float | None = None,
    ) -> None:
        """Angles (rad) and throttle (a share) from outside, for :data:`ATTITUDE_S` seconds."""
        until = self.plane.now + ATTITUDE_S
        self.doing = Doing.ATTITUDE
        given = {"roll": roll, "pitch": pitch, "throttle": throttle}
        self._forced |= {name: (value, until) for name, value in given.items() if value is not None}

    # ---- flying it

    def fly(self) -> None:
        plane, way, now = self.plane, self.plane.way, self.plane.now
        way.circle(self.radius)
        if not self._told and way.arrived_at is not None:
            self._told = True
            plane.reached(0)
        plane.fly_height(-way.down, plane.airspeed_wanted)
        forced = {name: value for name, (value, until) in self._forced.items() if now < until}
        if "roll" in forced:
            plane.sp.roll(forced["roll"])
        if "pitch" in forced:
            low, high = (math.radians(plane.params[f"PTCH_LIM_{end}_DEG"]) for end in ("MIN", "MAX"))
            plane.sp.pitch(min(max(forced["pitch"], low), high))
        plane.sp.yaw(0.0)
        if "throttle" in forced:
            plane.sp.power(min(max(forced["throttle"], 0.0), 1.0))
        self.doing = Doing.ATTITUDE if forced else Doing.POSITION
