"""AUTO: flies the mission, as ArduCopter does: https://ardupilot.org/copter/docs/auto-mode.html

Its commands: https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from zmav.sim.autopilots.arducopter.base import CopterBase
from zmav.sim.autopilots.arducopter.modes import Rtl, descend
from zmav.sim.autopilots.arducopter.travel import Travel
from zmav.sim.autopilots.ardupilot.plan import TERRAIN
from zmav.sim.autopilots.ardupilot.state import CRITICAL, INFO, AutoMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Axis, Spool, Vector

PASSING = (16, 17, 19)  # commands that a waypoint before them is passed to without a stop
LEAST_CLIMB_M = 1.0
ALLOW_ARMING, ALLOW_TAKEOFF_WITHOUT_THROTTLE = 1, 2  # AUTO_OPTIONS
SPEEDS = {0: "speed", 1: "speed", 2: "speed_up", 3: "speed_down"}  # SPEED_TYPE


class Auto(AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, changes_speed = 3, "AUTO", True
    NAVIGATION = (16, 17, 19, 20, 21, 22)

    def __init__(self, copter: CopterBase, travel: Travel, rtl: Rtl) -> None:
        super().__init__(copter)
        self.copter, self.travel, self.rtl = copter, travel, rtl
        self.leg: Leg | None = None
        self.travelled = False  # a place was flown to in this run

    # ---- the mode

    def allows_arming(self) -> bool:
        return bool(int(self.copter.params["AUTO_OPTIONS"]) & ALLOW_ARMING)

    def refusal(self) -> str:
        copter = self.copter
        if not copter.mission.present:
            return "init failed"
        if copter.landed and not copter.mission.starts_with_takeoff():
            copter.say(CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
        return ""

    def enter(self) -> None:
        self.leg, self.travelled, self.waiting = None, False, True
        if self.copter.armed:
            self.travel.stop()

    def on_arming(self) -> None:
        """The mission runs already; arming changes nothing about it."""

    def leave(self) -> None:
        super().leave()
        self.leg = None
        self.travel.release()

    def idle(self) -> None:
        """A mission that was chosen before arming runs as far as it gets on the ground."""
        self.run_mission()

    def update(self) -> None:
        copter = self.copter
        self.run_mission()
        if not copter.armed or copter.mode is not self:
            return
        if int(copter.params["AUTO_OPTIONS"]) & ALLOW_TAKEOFF_WITHOUT_THROTTLE and isinstance(self.leg, Takeoff):
            copter.auto_armed = True
        if self.leg is None:
            copter.spool()
            self.travel.update()
        else:
            self.leg.run()

    @property
    def is_landing(self) -> bool:
        if isinstance(self.leg, LandAt):
            return self.leg.descending
        return isinstance(self.leg, ReturnToLaunch) and self.rtl.is_landing

    @property
    def taking_off(self) -> bool:
        return isinstance(self.leg, Takeoff) and self.leg.rising

    @property
    def target(self) -> Vector | None:
        return self.travel.destination if self.travelled else None

    # ---- the mission's performer

    def set_out(self, item: Item) -> None:
        leg = LEGS[item.command]
        if not leg.keeps_way:
            self.travel.release()
        self.leg = leg(self, item)
        self.leg.begin()

    def arrived(self, item: Item) -> bool:
        return self.leg is not None and self.leg.done()

    def change_speed(self, item: Item) -> None:
        if item.p2 > 0 and int(item.p1) in SPEEDS:
            self.copter.change_speed(SPEEDS[int(item.p1)], item.p2)

    def finished(self) -> None:
        """The end of the mission: stay there, or disarm where it stands on the ground."""
        copter = self.copter
        self.leg = None
        if copter.landed:
            copter.disarm(forced=True)
        elif copter.position_ok:
            self.travel.stop()
            copter.heading.hold(copter.sense.yaw)
        else:
            copter.set_mode(9)


class Leg(ABC):
    """One command. ``begin`` once, ``run`` at every tick in the air, ``done`` until it says so."""

    keeps_way = False  # goes on with the way there is; the others set their own targets

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
            self.auto.travel.update()

    @abstractmethod
    def done(self) -> bool:
        """Whether the next command's turn has come."""

    @property
    def default(self) -> Vector:
        """What a command that leaves its place or height open means."""
        travel, s = self.auto.travel, self.copter.sense
        return travel.destination if self.auto.travelled and travel.reached else (s.north, s.east, s.down)

    def go(self, place: Vector, onward: Vector | None = None, follows: bool = False) -> None:
        """Fly there, nose ahead; ``follows``: over the terrain."""
        self.auto.travel.go(place, onward, follows)
        self.auto.travelled = True
        self.copter.heading.along(self.copter.params["WP_YAW_BEHAVIOR"], self.copter.sense.yaw)

    def waited(self, seconds: float) -> bool:
        """Arrived, and so many seconds have passed since."""
        if not self.auto.travel.reached:
            return False
        self._since = self.copter.now if self._since is None else self._since
        return int(self.copter.now - self._since) >= int(seconds)


class Takeoff(Leg):
    """Straight up; on the ground it waits until the pilot or MISSION_START lets it."""

    def begin(self) -> None:
        copter, s = self.copter, self.copter.sense
        _, _, down = copter.place_of(self.item, (s.north, s.east, s.down))
        self._down = min(down, s.down - (LEAST_CLIMB_M if copter.landed else 0.0))
        self._lift_at = math.inf if copter.landed else copter.now
        self._aim()

    def run(self) -> None:
        copter = self.copter
        if copter.landed and (not copter.auto_armed or copter.now < self._lift_at):
            copter.sp.spool(Spool.IDLE)
            if not copter.auto_armed:
                self._lift_at = math.inf
            elif self._lift_at == math.inf:
                self._lift_at = copter.spun_up_at
            self._aim()
            return
        copter.sp.spool(Spool.FLY)

    def _aim(self) -> None:
        copter, s = self.copter, self.copter.sense
        copter.sp.move(pos=(s.north, s.east, self._down))
        copter.heading.hold(s.yaw)

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
            self.auto.travel.destination, self.auto.travel.reached = (s.north, s.east, self._down), True
        return self._up


class Waypoint(Leg):
    """To a place, and on after ``p1`` seconds there."""

    keeps_way = True

    def begin(self) -> None:
        onward, follows = None, self.item.frame in TERRAIN
        following = self.copter.mission.next_navigation(self.item.seq + 1)
        place = self.copter.place_of(self.item, self.default)
        passing = self.item.p1 == 0 and following is not None and following.command in PASSING
        if passing and following is not None and (following.frame in TERRAIN) == follows:
            onward = self.copter.place_of(following, place)
        self.go(place, onward, follows)

    def done(self) -> bool:
        if not self.waited(self.item.p1):
            return False
        self.copter.say(INFO, f"Reached command #{self.item.seq}")
        return True


class LoiterTime(Waypoint):
    def begin(self) -> None:
        self.go(self.copter.place_of(self.item, self.default), follows=self.item.frame in TERRAIN)


class LoiterForever(LoiterTime):
    def done(self) -> bool:
        return False


class ReturnToLaunch(Leg):
    """As the RTL mode does, landing included."""

    def begin(self) -> None:
        self.auto.rtl.enter()

    def run(self) -> None:
        self.auto.rtl.update()

    def done(self) -> bool:
        return self.auto.rtl.is_landing and self.copter.landed


class LandAt(Leg):
    """Over the place at the height it has, then down; the mission ends there."""

    keeps_way = True

    def begin(self) -> None:
        self.descending = self.item.here
        if self.descending:
            self._descend()
            return
        north, east, _ = self.copter.place_of(self.item, self.default)
        self.go((north, east, self.copter.sense.down))

    def _descend(self) -> None:
        self.descending = True
        self.auto.travel.release()
        self.copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.copter.heading.hold(self.copter.sense.yaw)

    def run(self) -> None:
        if not self.copter.spool():
            return
        if self.descending:
            descend(self.copter)
            return
        self.auto.travel.update()
        if self.auto.travel.reached:
            self._descend()

    def done(self) -> bool:
        if not (self.descending and self.copter.landed and self.copter.settled):
            return False
        if not self.copter.armed:
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
