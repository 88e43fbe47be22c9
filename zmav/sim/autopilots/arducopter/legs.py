"""The navigation commands of a mission, each as ArduCopter flies it in AUTO.

Commands: https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from zmav.sim.autopilots.arducopter.modes import descend
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Axis, Spool, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.arducopter.auto import Auto

INFO = 6
PASSING = (16, 17, 19)  # commands that a waypoint before them is passed to without a stop
LEAST_CLIMB_M = 1.0


class Leg(ABC):
    """One command. ``begin`` once, ``run`` at every tick in the air, ``done`` until it says so."""

    restarts = False  # begun again where the mission is changed under way

    def __init__(self, auto: Auto, item: Item) -> None:
        self.auto = auto
        self.copter = auto.copter
        self.item = item
        self._since: float | None = None

    @abstractmethod
    def begin(self) -> None:
        """Set out."""

    def run(self) -> None:
        """Set this moment's targets, on the ground too; the motors are armed."""
        if self.copter.spool():
            self.copter.travel.update()

    @abstractmethod
    def done(self) -> bool:
        """Whether the next command's turn has come."""

    @property
    def default(self) -> Vector:
        """What a command that leaves its place or height open means."""
        travel, s = self.copter.travel, self.copter.sense
        return travel.destination if self.auto.travelled and travel.reached else (s.north, s.east, s.down)

    def go(self, item: Item, onward: Vector | None = None) -> Vector:
        place = self.copter.place_of(item, self.default)
        self.copter.travel.go(place, onward)
        self.auto.travelled = True
        self.auto.look_ahead()
        return place

    def waited(self, seconds: float) -> bool:
        """Arrived, and so many seconds have passed since."""
        if not self.copter.travel.reached:
            return False
        self._since = self.copter.now if self._since is None else self._since
        return int(self.copter.now - self._since) >= int(seconds)


class Takeoff(Leg):
    """Straight up; on the ground it waits until the pilot or MISSION_START lets it."""

    def begin(self) -> None:
        copter, s = self.copter, self.copter.sense
        _, _, down = copter.place_of(self.item, (s.north, s.east, s.down))
        self._down = min(down, s.down - (LEAST_CLIMB_M if copter.landed else 0.0))
        self._lift_at = math.inf
        copter.heading.hold(s.yaw)

    def run(self) -> None:
        copter = self.copter
        if copter.landed and (not copter.auto_armed or copter.now < self._lift_at):
            copter.sp.spool(Spool.IDLE)
            if not copter.auto_armed:
                self._lift_at = math.inf
            elif self._lift_at == math.inf:
                self._lift_at = copter.spun_up_at
            self._place = (copter.sense.north, copter.sense.east, self._down)
            copter.sp.move(pos=self._place)
            copter.heading.hold(copter.sense.yaw)
            return
        copter.sp.spool(Spool.FLY)

    @property
    def rising(self) -> bool:
        """The motors are up to lift it, and it is not there yet."""
        return self.copter.now >= self._lift_at and not self._up

    @property
    def _up(self) -> bool:
        copter, s = self.copter, self.copter.sense
        slow = -s.vd < 0.1 * copter.sp.limit_of("speed_up")
        return not copter.landed and slow and s.down <= self._down + 0.1

    def done(self) -> bool:
        if self._up:
            s = self.copter.sense
            self.copter.travel.destination, self.copter.travel.reached = (s.north, s.east, self._down), True
        return self._up


class Waypoint(Leg):
    """To a place, and on after ``p1`` seconds there."""

    restarts = True

    def begin(self) -> None:
        onward = None
        following = self.copter.mission.next_navigation(self.item.seq + 1)
        place = self.copter.place_of(self.item, self.default)
        if self.item.p1 == 0 and following is not None and following.command in PASSING:
            onward = self.copter.place_of(following, place)
        self.go(self.item, onward)

    def done(self) -> bool:
        if not self.waited(self.item.p1):
            return False
        self.copter.say(INFO, f"Reached command #{self.item.seq}")
        return True


class LoiterForever(Leg):
    restarts = True

    def begin(self) -> None:
        self.go(self.item)

    def done(self) -> bool:
        return False


class LoiterTime(LoiterForever):
    def done(self) -> bool:
        if not self.waited(self.item.p1):
            return False
        self.copter.say(INFO, f"Reached command #{self.item.seq}")
        return True


class ReturnToLaunch(Leg):
    """As the RTL mode does, landing included."""

    def begin(self) -> None:
        self.copter.rtl.enter()

    def run(self) -> None:
        self.copter.rtl.update()

    def done(self) -> bool:
        return self.copter.rtl.landing and self.copter.landed


class LandAt(Leg):
    """Over the place at the height it has, then down; the mission ends there unless a takeoff may follow."""

    def begin(self) -> None:
        self.descending = self.item.here
        if self.descending:
            self._descend()
            return
        north, east, _ = self.copter.place_of(self.item, self.default)
        self.copter.travel.go((north, east, self.copter.sense.down))
        self.auto.travelled = True
        self.auto.look_ahead()

    def _descend(self) -> None:
        self.descending = True
        self.copter.travel.release()
        self.copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.copter.heading.hold(self.copter.sense.yaw)

    def run(self) -> None:
        if not self.copter.spool():
            return
        if self.descending:
            descend(self.copter)
            return
        self.copter.travel.update()
        if self.copter.travel.reached:
            self._descend()

    def done(self) -> bool:
        if not (self.descending and self.copter.landed and self.copter.settled):
            return False
        if self.copter.mission.goes_on_after_landing or not self.copter.armed:
            return True
        self.copter.disarm(forced=True)
        return False


LEGS: dict[int, type[Leg]] = {
    16: Waypoint,
    17: LoiterForever,
    19: LoiterTime,
    20: ReturnToLaunch,
    21: LandAt,
    22: Takeoff,
}
