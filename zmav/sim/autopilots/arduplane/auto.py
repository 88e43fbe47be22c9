"""AUTO: flies the mission, and AUTOLAND: lands where it took off; as ArduPlane does.

https://ardupilot.org/plane/docs/auto-mode.html, https://ardupilot.org/plane/docs/autoland-mode.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.mode import AutoMode
from zmav.sim.autopilots.arduplane.legs import LEGS, Leg, ReturnToLaunch, Takeoff
from zmav.sim.autopilots.arduplane.modes import PlaneMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    pass

_WARNING, _INFO = 4, 6


class Auto(PlaneMode, AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, auto_throttle, navigates, changes_speed = 10, "AUTO", True, True, True
    armable: ClassVar[bool] = True
    NAVIGATION = LEGS

    leg: Leg | None = None
    previous: Item | None = None
    """the navigation command before the running one"""
    _item: Item | None = None
    force_resume = False

    # ---- the mode

    def enter(self) -> None:
        plane = self.plane
        self.leg = None
        plane.way.start = plane.way.end = plane.here
        plane.way.next_crosstrack = False
        if self.force_resume:
            self.force_resume = False
            plane.mission.resume()
        else:
            plane.mission.start_or_resume()

    def on_arming(self) -> None:
        """The mission runs already."""

    def leave(self) -> None:
        mission = self.plane.mission
        if mission.state is State.RUNNING:
            landing = self.leg is not None and self.leg.landing
            mission.stop()
            if landing and self.previous is not None:
                # A landing that is given up is begun again with its approach.
                mission.set_current(self.previous.seq)
        self.leg = None
        self.plane.landing.stop()

    def idle(self) -> None:
        """A mission that was chosen before arming runs as far as it gets on the ground."""
        if self.plane.on_turn:
            if self.plane.boot.has("origin"):
                self.plane.mission.update()
            self.rest()
            self.plane.sp.power(0.0)

    def fly(self) -> None:
        plane = self.plane
        plane.mission.update()
        if plane.mode is not self:
            return
        if plane.mission.state is not State.RUNNING or self.leg is None:
            plane.set_mode(11)
            plane.say(_INFO, "Aircraft in auto without a running mission")
            return
        self.leg.fly()

    @property
    def is_landing(self) -> bool:
        return self.leg is not None and self.leg.landing

    @property
    def taking_off(self) -> bool:
        return isinstance(self.leg, Takeoff)

    @property
    def target(self) -> Vector | None:
        return self.plane.way.end

    # ---- the mission's performer

    def set_out(self, item: Item) -> None:
        leg = LEGS[item.command]
        self.previous, self._item = self._item, item
        self.plane.landing.stop()
        self.plane.taken_off = True
        if leg is ReturnToLaunch:
            self.plane.set_mode(11)
        else:
            self.leg = leg(self.plane, item)
            self.leg.begin()

    def arrived(self, item: Item) -> bool:
        return self.leg is not None and self.leg.done()

    def change_speed(self, item: Item) -> None:
        self.plane.ask_speed(int(item.p1), item.p2, item.p3)

    def finished(self) -> None:
        """The end of the mission."""
        self.leg = None
        self.plane.set_mode(11)
        self.plane.say(_INFO, "Mission complete, changing mode to RTL")


class AutoLand(PlaneMode):
    """Round a point beside the approach, down to its height, and along the direction of the takeoff to home."""

    number, name, auto_throttle, navigates = 26, "AUTOLAND", True, True

    def refusal(self) -> str:
        plane = self.plane
        if not plane.flying:
            plane.say(_WARNING, "Must already be flying!")
            return "on the ground"
        if plane.takeoff_direction is None:
            plane.say(_WARNING, "Takeoff initial direction not set")
            return "no direction"
        return ""

    def enter(self) -> None:
        plane, params, way = self.plane, self.plane.params, self.plane.way
        course = plane.takeoff_direction or 0.0
        far, home = params["AUTOLAND_WP_DIST"], plane.home_world
        self._start = (
            home[0] - far * math.cos(course),
            home[1] - far * math.sin(course),
            home[2] - params["AUTOLAND_WP_ALT"],
        )
        here = plane.here
        from_start = math.atan2(here[1] - self._start[1], here[0] - self._start[0])
        error = math.remainder(course - from_start, math.tau)
        left = error > 0.0  # it comes from the left of the approach
        aside = course + (-0.5 if left else 0.5) * math.pi
        self._radius = min(far / 3.0, abs(params["WP_LOITER_RAD"]) or far / 3.0)
        actual = self._radius * plane.eas2tas**2
        centre = self._start[0] + actual * math.cos(aside), self._start[1] + actual * math.sin(aside), self._start[2]
        way.direct(centre)
        way.counter_clockwise = left
        self._climb = here[2] - params["AUTOLAND_CLIMB"] if params["AUTOLAND_CLIMB"] > plane.height else None
        self._final = False

    def leave(self) -> None:
        self.plane.landing.stop()

    @property
    def is_landing(self) -> bool:
        return self._final

    def fly(self) -> None:
        plane, way = self.plane, self.plane.way
        if self._final:
            plane.landing.update()
            return
        way.circle(self._radius)
        plane.fly_height(-way.down, plane.airspeed_wanted)
        if self._climb is not None:
            plane.limit(roll=math.radians(plane.params["LEVEL_ROLL_LIMIT"]))
            self._climb = None if plane.sense.down < self._climb else self._climb
        elif way.turned > 0.0 and way.reached_height and way.lined_up(plane.home_world):
            plane.say(_INFO, "Loiter to alt complete")
            self._final = True
            way.start, way.end, way.crosstrack = self._start, plane.home_world, True
            way.level()
            plane.landing.begin(loitered=True)
