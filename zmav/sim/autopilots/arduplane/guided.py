"""GUIDED: circles about the places that the ground or a companion names, and takes heights and attitudes
beside them. ArduPlane's ways with each: https://ardupilot.org/dev/docs/plane-commands-in-guided-mode.html

Attitudes and throttle are dropped :data:`ATTITUDE_S` seconds after the last one; everything else stays.
"""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.ardupilot.state import GuidedMode
from zmav.sim.autopilots.ardupilot.targets import Doing, Target
from zmav.sim.autopilots.arduplane.modes import PlaneMode

ATTITUDE_S = 3.0


class Guided(PlaneMode, GuidedMode):
    number, name, auto_throttle, navigates, changes_speed = 15, "GUIDED", True, True, True
    armable: ClassVar[bool] = True

    def enter(self) -> None:
        self.radius = 0.0
        self.doing, self.target = Doing.POSITION, Target()
        self._roll: tuple[float, float] | None = None  # and until when
        self._pitch: tuple[float, float] | None = None
        self._throttle: tuple[float, float] | None = None
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
        self._roll = self._roll if roll is None else (roll, until)
        self._pitch = self._pitch if pitch is None else (pitch, until)
        self._throttle = self._throttle if throttle is None else (throttle, until)

    # ---- flying it

    def fly(self) -> None:
        plane, way, now = self.plane, self.plane.way, self.plane.now
        way.circle(self.radius)
        if not self._told and way.arrived_at is not None:
            self._told = True
            plane.reached(0)
        plane.fly_height(-way.down, plane.airspeed_wanted)
        forced = False
        if self._roll is not None and now < self._roll[1]:
            plane.sp.roll(self._roll[0])
            forced = True
        if self._pitch is not None and now < self._pitch[1]:
            low, high = (math.radians(plane.params[f"PTCH_LIM_{end}_DEG"]) for end in ("MIN", "MAX"))
            plane.sp.pitch(min(max(self._pitch[0], low), high))
            forced = True
        plane.sp.yaw(0.0)
        if self._throttle is not None and now < self._throttle[1]:
            plane.sp.power(min(max(self._throttle[0], 0.0), 1.0))
            forced = True
        self.doing = Doing.ATTITUDE if forced else Doing.POSITION
