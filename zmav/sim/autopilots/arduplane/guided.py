"""GUIDED: circles about the places that the ground or a companion names, and takes heights, speeds, headings and
attitudes beside them. ArduPlane's ways with each: https://ardupilot.org/dev/docs/plane-commands-in-guided-mode.html

Attitudes and throttle are dropped :data:`ATTITUDE_S` seconds after the last one; everything else stays.
"""

from __future__ import annotations

import math
from typing import ClassVar

import msgspec

from zmav.sim.autopilots.ardupilot.targets import AttitudeTarget, Doing, Target
from zmav.sim.autopilots.ardupilot.vehicle import GuidedMode
from zmav.sim.autopilots.arduplane.modes import PlaneMode
from zmav.sim.dynamics.airframe import GRAVITY

ATTITUDE_S = 3.0
LEAST_TURN = 0.05  # m/s^2


class _Slew(msgspec.Struct):
    """A number on its way to ``goal`` by ``rate`` a second."""

    now: float
    goal: float
    rate: float

    def advance(self, dt: float) -> float:
        step = self.rate * dt
        self.now += min(max(self.goal - self.now, -step), step)
        return self.now


class Guided(PlaneMode, GuidedMode):
    number, name, auto_throttle, navigates, changes_speed = 15, "GUIDED", True, True, True
    armable: ClassVar[bool] = True

    def enter(self) -> None:
        self.radius = 0.0
        self.doing, self.target = Doing.POSITION, Target()
        self._height: _Slew | None = None
        self._speed: _Slew | None = None
        self._heading: tuple[float, bool, float] | None = None
        self._roll: tuple[float, float] | None = None  # and until when
        self._pitch: tuple[float, float] | None = None
        self._throttle: tuple[float, float] | None = None
        self._yaw: tuple[float, float] | None = None
        self._told = True
        self.plane.way.stay()

    # ---- what it is told

    def hold(self) -> None:
        """What makes no sense is not taken."""

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
        self.target, self._heading, self._height, self._told = Target(pos=place), None, None, False

    def change_height(self, down: float, rate: float = 0.0) -> None:
        """To another height; ``rate`` m/s, 0: as fast as it goes."""
        if rate > 0.0:
            self._height = _Slew(self.plane.sense.down, down, rate)
        else:
            self._height = None
            self.plane.way.end = *self.plane.way.end[:2], down
            self.plane.way.level()

    def change_airspeed(self, speed: float, rate: float = 0.0) -> bool:
        """To another equivalent airspeed at ``rate`` m/s^2 (0: at once); False beyond the envelope."""
        params = self.plane.params
        if not params["AIRSPEED_MIN"] <= speed <= params["AIRSPEED_MAX"]:
            return False
        before = self.plane.airspeed_wanted
        self._speed = _Slew(before if rate > 0.0 else speed, speed, abs(rate))
        return True

    def change_heading(self, angle: float | None, *, course: bool = False, accel: float = LEAST_TURN) -> None:
        """Hold a heading, or a ``course`` over the ground, turning with ``accel`` m/s^2; None: circle again."""
        self._heading = None if angle is None else (angle, course, max(accel, LEAST_TURN))

    def lean(self, target: AttitudeTarget) -> None:
        """Not used: a plane takes angles one by one, see :meth:`force`."""

    def force(
        self,
        *,
        roll: float | None = None,
        pitch: float | None = None,
        rudder: float | None = None,
        throttle: float | None = None,
    ) -> None:
        """Angles (rad), rudder and throttle (shares) from outside, for :data:`ATTITUDE_S` seconds."""
        until = self.plane.now + ATTITUDE_S
        self.doing = Doing.ATTITUDE
        self._roll = self._roll if roll is None else (roll, until)
        self._pitch = self._pitch if pitch is None else (pitch, until)
        self._yaw = self._yaw if rudder is None else (rudder, until)
        self._throttle = self._throttle if throttle is None else (throttle, until)

    @property
    def airspeed(self) -> float | None:
        """What was asked for by GUIDED_CHANGE_SPEED, on its way."""
        return None if self._speed is None else self._speed.now

    # ---- flying it

    def fly(self) -> None:
        plane, way, now = self.plane, self.plane.way, self.plane.now
        if self._speed is not None:
            self._speed.advance(plane.turn_s)
        way.circle(self.radius)
        if not self._told and way.arrived_at is not None:
            self._told = True
            plane.reached(0)
        down = way.down if self._height is None else self._height.advance(plane.turn_s)
        plane.fly_height(-down, plane.airspeed_wanted)
        if self._heading is not None:
            self._turn(*self._heading)
        forced = False
        if self._roll is not None and now < self._roll[1]:
            plane.sp.roll(self._roll[0])
            forced = True
        if self._pitch is not None and now < self._pitch[1]:
            low, high = (math.radians(plane.params[f"PTCH_LIM_{end}_DEG"]) for end in ("MIN", "MAX"))
            plane.sp.pitch(min(max(self._pitch[0], low), high))
            forced = True
        plane.sp.yaw(self._yaw[0] if self._yaw is not None and now < self._yaw[1] else 0.0)
        if self._throttle is not None and now < self._throttle[1]:
            plane.sp.power(min(max(self._throttle[0], 0.0), 1.0))
            forced = True
        self.doing = Doing.ATTITUDE if forced else Doing.POSITION

    def _turn(self, angle: float, course: bool, accel: float) -> None:
        plane, s = self.plane, self.plane.sense
        now = math.atan2(s.ve, s.vn) if course else s.yaw
        error = (angle - now + math.pi) % (2.0 * math.pi) - math.pi
        most = math.atan(accel / GRAVITY)
        gain = plane.params["GUIDED_P"] * 0.01 * math.radians(1.0)
        plane.sp.roll(min(max(error * gain, -most), most))
