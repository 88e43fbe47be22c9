"""The navigation commands of a mission, each as ArduPlane flies it in AUTO.

Commands: https://ardupilot.org/plane/docs/mission-command-list.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arduplane.plane import ArduPlane

INFO = 6
COURSE_SPEED = 5.0  # m/s
NO_PITCH = math.radians(4.0)  # of a takeoff whose item names none
CLOSE_M = 5.0


class Leg(ABC):
    """One command. ``begin`` once, ``fly`` twenty times a second, ``done`` until it says so."""

    landing = False

    def __init__(self, plane: ArduPlane, item: Item) -> None:
        self.plane = plane
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
        plane.launch.begin(self._height + plane.home_world[2], pitch)
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
    """Past a place: within ``p2`` metres of it (0: the turn's distance), or ``p3`` metres beyond it."""

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

    def fly(self) -> None:
        self.plane.way.follow(self.item.p3)
        self._keep_height()

    def done(self) -> bool:
        plane, way = self.plane, self.plane.way
        line = math.hypot(way.end[0] - way.start[0], way.end[1] - way.start[1])
        left = way.distance
        if self.item.p2 > 0:
            radius = self.item.p2
        elif self.item.p3 > 0:
            radius = 0.0
        else:
            # As early as the turn onto the next leg needs.
            radius = min(max(plane.params["WP_RADIUS"], 1.0) * plane.eas2tas**2, plane.sp.flown().turn_distance)
            radius *= self._turn
        farthest = plane.params["WP_MAX_RADIUS"]
        passed = way.share * line > line + self.item.p3 if line > 1e-3 else left < CLOSE_M
        if 0 < farthest < left:
            return False
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
    """Down to a place; it never ends but by disarming, or goes on where MIS_OPTIONS lets it."""

    landing = True

    def begin(self) -> None:
        plane = self.plane
        plane.way.go(self.place)
        plane.way.level()
        plane.landing.begin(loitered=self._comes_from_a_loiter())

    def _comes_from_a_loiter(self) -> bool:
        before = self.plane.auto.previous
        return before is not None and before.command == 31

    def fly(self) -> None:
        self.plane.landing.update()

    def done(self) -> bool:
        plane = self.plane
        return plane.landing.flaring and plane.groundspeed < 1.0 and plane.mission.goes_on_after_landing


class ReturnToLaunch(Leg):
    def begin(self) -> None:
        self.plane.set_mode(11)

    def fly(self) -> None:
        """RTL flies by now."""

    def done(self) -> bool:
        return False


LEGS: dict[int, type[Leg]] = {
    16: Waypoint,
    17: LoiterForever,
    19: LoiterTime,
    20: ReturnToLaunch,
    21: LandAt,
    22: Takeoff,
    31: LoiterToAlt,
}
