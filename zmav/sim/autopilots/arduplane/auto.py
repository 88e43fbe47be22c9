"""AUTO: flies the mission, and AUTOLAND: lands where it took off; as ArduPlane does.

https://ardupilot.org/plane/docs/auto-mode.html, https://ardupilot.org/plane/docs/autoland-mode.html; commands:
https://ardupilot.org/plane/docs/mission-command-list.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.state import INFO, WARNING, AutoMode
from zmav.sim.autopilots.arduplane.modes import PlaneMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

RTL = 20  # MAV_CMD_NAV_RETURN_TO_LAUNCH
COURSE_SPEED = 5.0  # m/s
NO_PITCH = math.radians(4.0)  # of a takeoff whose item names none
CLOSE_M = 5.0


class Auto(PlaneMode, AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, auto_throttle, navigates, changes_speed = 10, "AUTO", True, True, True
    NAVIGATION = (16, 17, 19, RTL, 21, 22, 31)

    leg: Leg | None = None
    previous: Item | None = None
    """the navigation command before the running one"""
    _item: Item | None = None

    # ---- the mode

    def enter(self) -> None:
        plane = self.plane
        self.leg = None
        plane.way.start = plane.way.end = plane.here
        plane.way.next_crosstrack = False
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
            plane.say(INFO, "Aircraft in auto without a running mission")
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
        self.previous, self._item = self._item, item
        self.plane.landing.stop()
        self.plane.taken_off = True
        if item.command == RTL:
            self.plane.set_mode(11)
        else:
            self.leg = LEGS[item.command](self, item)
            self.leg.begin()

    def arrived(self, item: Item) -> bool:
        return self.leg is not None and self.leg.done()

    def change_speed(self, item: Item) -> None:
        self.plane.ask_speed(int(item.p1), item.p2)

    def finished(self) -> None:
        """The end of the mission."""
        self.leg = None
        self.plane.set_mode(11)
        self.plane.say(INFO, "Mission complete, changing mode to RTL")


class AutoLand(PlaneMode):
    """Round a point beside the approach, down to its height, and along the direction of the takeoff to home."""

    number, name, auto_throttle, navigates = 26, "AUTOLAND", True, True

    def blocked(self) -> str:
        plane = self.plane
        if not plane.flying:
            plane.say(WARNING, "Must already be flying!")
            return "on the ground"
        if plane.takeoff_direction is None:
            plane.say(WARNING, "Takeoff initial direction not set")
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
        if way.turned > 0.0 and way.reached_height and way.lined_up(plane.home_world):
            plane.say(INFO, "Loiter to alt complete")
            self._final = True
            way.start, way.end, way.crosstrack = self._start, plane.home_world, True
            way.level()
            plane.landing.begin(loitered=True)


class Leg(ABC):
    """One command. ``begin`` once, ``fly`` twenty times a second, ``done`` until it says so."""

    landing = False

    def __init__(self, auto: Auto, item: Item) -> None:
        self.auto, self.plane = auto, auto.plane
        self.item = item

    @abstractmethod
    def begin(self) -> None:
        """Set out."""

    def fly(self) -> None:
        """Set this moment's targets."""
        self.plane.way.follow()
        self._keep_height()

    @abstractmethod
    def done(self) -> bool:
        """Whether the next command's turn has come."""

    def _keep_height(self) -> None:
        self.plane.fly_height(-self.plane.way.down, self.plane.airspeed_wanted)

    @property
    def place(self) -> Vector:
        """Without a place of its own an item means where the plane is."""
        return self.plane.place_of(self.item, self.plane.here if self.item.here else None)


class Takeoff(Leg):
    """On the course of the roll to a height, with at least the item's pitch."""

    def begin(self) -> None:
        plane = self.plane
        self._height = -self.place[2]
        pitch = math.radians(self.item.p1) if self.item.p1 > 0 else NO_PITCH
        plane.launch.begin(pitch)
        plane.way.end = *plane.here[:2], -self._height
        self._course: float | None = None
        plane.taken_off = False

    def fly(self) -> None:
        plane, s = self.plane, self.plane.sense
        if self._course is None and plane.groundspeed > COURSE_SPEED:
            self._course = math.atan2(s.ve, s.vn)
            centidegrees = round(math.degrees(self._course) * 100.0) % 36000
            plane.say(INFO, f"Holding course {centidegrees} at {plane.groundspeed:.1f}m/s (0.0)")
        if self._course is None:
            plane.sp.roll(0.0)
        else:
            plane.sp.fly_heading(self._course)
        plane.launch.climb(self._height)

    def done(self) -> bool:
        plane = self.plane
        if -plane.sense.down <= self._height:
            return False
        plane.say(INFO, f"Takeoff complete at {plane.height:.2f}m")
        plane.taken_off = True
        plane.way.start = plane.way.end = plane.here
        plane.way.next_crosstrack = False
        return True


class Waypoint(Leg):
    """Past a place, as early as the turn onto the next leg needs."""

    def begin(self) -> None:
        self.plane.way.go(self.place)
        self._turn = self._next_turn()

    def _next_turn(self) -> float:
        """How far the next leg turns from this one, as a share of a right angle, at most 1."""
        plane, way = self.plane, self.plane.way
        following = plane.mission.next_navigation(self.item.seq + 1)
        if following is None or following.here:
            return 1.0
        onward = plane.place_of(following, way.end)
        course = math.atan2(onward[1] - way.end[1], onward[0] - way.end[0])
        turn = abs(math.remainder(course - way.course, math.tau))
        return min(turn / (0.5 * math.pi), 1.0)

    def done(self) -> bool:
        plane, way = self.plane, self.plane.way
        line = math.hypot(way.end[0] - way.start[0], way.end[1] - way.start[1])
        left = way.distance
        radius = (
            min(max(plane.params["WP_RADIUS"], 1.0) * plane.eas2tas**2, plane.sp.flown().turn_distance) * self._turn
        )
        passed = way.share * line > line if line > 1e-3 else left < CLOSE_M
        if left <= radius or passed:
            word = "Reached" if left <= radius else "Passed"
            plane.say(INFO, f"{word} waypoint #{self.item.seq} dist {int(left)}m")
            return True
        return False


class LoiterForever(Leg):
    """``p3``: radius in metres, negative counter-clockwise."""

    def begin(self) -> None:
        self.plane.way.go(self.place)
        self.plane.way.counter_clockwise |= self._radius < 0

    @property
    def place(self) -> Vector:
        """Where and how high the plane is, for what the item leaves open."""
        return self.plane.place_of(self.item, self.plane.here)

    @property
    def _radius(self) -> float:
        return self.item.p3

    def fly(self) -> None:
        self.plane.way.circle(self._radius)
        self._keep_height()

    def done(self) -> bool:
        return False

    def _leaves(self) -> bool:
        """It flies toward the next place."""
        plane = self.plane
        following = plane.mission.next_navigation(self.item.seq + 1)
        if following is None or following.here or plane.way.lined_up(plane.place_of(following, plane.here)):
            if self.item.p4 > 0:
                plane.way.end = *plane.here[:2], plane.way.end[2]
            return True
        return False


class LoiterTime(LoiterForever):
    @property
    def _radius(self) -> float:
        """Its sign alone: WP_LOITER_RAD is flown."""
        return math.copysign(0.5, self.item.p3)

    def done(self) -> bool:
        plane, since = self.plane, self.plane.way.arrived_at
        if since is None or plane.now - since <= self.item.p1 or not self._leaves():
            return False
        plane.say(INFO, "Loiter time complete")
        return True


class LoiterToAlt(LoiterForever):
    """Round a place, ``p2`` metres away, until the height is reached."""

    @property
    def _radius(self) -> float:
        return self.item.p2

    def done(self) -> bool:
        way = self.plane.way
        if not (way.turned > 0.0 and way.reached_height) or not self._leaves():
            return False
        self.plane.say(INFO, "Loiter to alt complete")
        return True


class LandAt(Leg):
    """Down to a place; it never ends but by disarming."""

    landing = True

    def begin(self) -> None:
        plane = self.plane
        plane.way.go(self.place)
        plane.way.level()
        before = self.auto.previous
        plane.landing.begin(loitered=before is not None and before.command == 31)

    def fly(self) -> None:
        self.plane.landing.update()

    def done(self) -> bool:
        return False


LEGS: dict[int, type[Leg]] = {
    16: Waypoint,
    17: LoiterForever,
    19: LoiterTime,
    21: LandAt,
    22: Takeoff,
    31: LoiterToAlt,
}
