"""AUTO: drives the mission, as ArduRover does: https://ardupilot.org/rover/docs/auto-mode.html"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

from zmav.rotation import wrap
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.vehicle import AutoMode
from zmav.sim.autopilots.ardupilot.waits import CONDITION_DELAY, CONDITION_DISTANCE, UNREPORTED, Conditions, delay
from zmav.sim.autopilots.ardurover.circle import Circle
from zmav.sim.autopilots.ardurover.modes import RoverMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardurover.rover import ArduRover

CRITICAL, WARNING, NOTICE, INFO = 2, 4, 5, 6
WAYPOINT, LOITER_UNLIM, LOITER_TURNS, LOITER_TIME, RTL = 16, 17, 18, 19, 20  # MAV_CMD
GUIDED_ENABLE, DELAY, SET_YAW_SPEED = 92, 93, 213
CHANGE_SPEED, SET_HOME, REVERSE, GUIDED_LIMITS = 178, 179, 194, 222
REGIONS = (195, 197, 201)
KNOWN = frozenset((CONDITION_DELAY, CONDITION_DISTANCE, CHANGE_SPEED, SET_HOME, *REGIONS, REVERSE, 207, GUIDED_LIMITS))
HEADING_DONE = math.radians(5.0)
HOLD, LOITER, ACRO, MANUAL = range(4)  # MIS_DONE_BEHAVE
_MODES = {ACRO: 1, MANUAL: 0}


class Part(enum.Enum):
    """What it does now."""

    STOP = "stop"
    WAY = "way"
    HEADING = "heading"
    RTL = "rtl"
    LOITER = "loiter"
    GUIDED = "guided"
    CIRCLE = "circle"


class Auto(RoverMode, AutoMode):
    """Also the mission's performer: starts its commands and says when they are done."""

    number, name, autopilot, changes_speed = 10, "AUTO", True, True

    def __init__(self, rover: ArduRover) -> None:
        super().__init__(rover)
        self.circle = Circle(rover)
        self.part = Part.STOP
        self._waiting = False
        self._changes = 0
        self._driven: tuple[Item, ...] = ()
        self._delay_end = 0.0
        self._conditions = Conditions()
        self._stay = 0
        self._there_at: float | None = None
        self._yaw = self._speed = 0.0
        self._headed = False
        self._guided_to: Point | None = None

    # ---- the mode

    def blocked(self) -> str:
        if self.rover.mission.present:
            return ""
        self.rover.say(NOTICE, "No Mission. Can't set AUTO.")
        return "there is no mission"

    def enter(self) -> None:
        self.rover.travel.begin()
        self.rover.guided.limit(0.0, 0.0)
        self.part, self._waiting = Part.STOP, True

    def leave(self) -> None:
        if self.rover.mission.state is State.RUNNING:
            self.rover.mission.stop()

    def update(self) -> None:
        rover = self.rover
        if not rover.armed and not rover.mission.present:
            self.part = Part.STOP
        self._run_mission()
        if rover.mode is not self:
            return
        if self.part is Part.WAY:
            rover.travel.update()
        elif self.part is Part.HEADING:
            self._turn_to()
        elif self.part is Part.RTL:
            rover.rtl.update()
        elif self.part is Part.LOITER:
            rover.loiter.update()
        elif self.part is Part.GUIDED:
            rover.guided.update()
        elif self.part is Part.CIRCLE:
            self.circle.update()
        else:
            rover.stop()

    def _run_mission(self) -> None:
        rover, mission = self.rover, self.rover.mission
        if self._waiting:
            if rover.boot.has("origin"):
                self._waiting = False
                mission.start_or_resume()
                self._note_mission()
            return
        if mission.changes != self._changes:
            before = self._driven
            self._note_mission()
            if self._driven != before and mission.state is State.RUNNING and self.part is Part.WAY:
                outcome = ", restarted command" if mission.restart_current() else " but failed to restart command"
                rover.say(CRITICAL, f"Auto mission changed{outcome}")
        mission.update()

    def _note_mission(self) -> None:
        self._changes, self._driven = self.rover.mission.changes, self.rover.mission.upcoming

    def _turn_to(self) -> None:
        rover = self.rover
        if self._headed:
            rover.stop()
            return
        rover.sp.back(False)
        rover.sp.head(self._yaw, rover.nudged(self._speed))
        self._headed = abs(wrap(self._yaw - rover.sense.yaw)) < HEADING_DONE

    # ---- what it tells: as the part that it drives now

    @property
    def _as(self) -> RoverMode | None:
        rover = self.rover
        parts: dict[Part, RoverMode] = {
            Part.RTL: rover.rtl,
            Part.LOITER: rover.loiter,
            Part.GUIDED: rover.guided,
            Part.CIRCLE: self.circle,
        }
        return parts.get(self.part)

    @property
    def guided(self) -> bool:
        return self.part is Part.GUIDED

    @property
    def place(self) -> Vector | None:
        if self.part is Part.GUIDED:
            return self.rover.guided.place
        if self.part is Part.WAY:
            place = self.rover.travel.destination
            return None if place is None else self.at(place)
        return None if self._as is None else self._as.place

    @property
    def target(self) -> Vector | None:
        return self.place

    @property
    def distance(self) -> float:
        return self.rover.travel.distance if self.part is Part.WAY else self._as.distance if self._as else 0.0

    @property
    def bearing(self) -> float:
        return self.rover.travel.bearing if self.part is Part.WAY else self._as.bearing if self._as else 0.0

    @property
    def cross_track(self) -> float:
        return self.rover.travel.cross_track if self.part is Part.WAY else self._as.cross_track if self._as else 0.0

    def set_speed(self, speed: float) -> bool:
        if self.part is Part.HEADING:
            self._speed = speed
            return True
        if self.part in (Part.WAY, Part.STOP):
            return self.rover.travel.change_speed(speed)
        return self._as is not None and self._as.set_speed(speed)

    # ---- the mission's performer

    def start(self, item: Item) -> bool:
        command = item.command
        if command in (WAYPOINT, LOITER_UNLIM, LOITER_TIME):
            self._go(item, stops=command != WAYPOINT)
        elif command == RTL:
            self.rover.rtl.enter()
            self.part = Part.RTL
        elif command == LOITER_TURNS:
            place = self._place(item)
            self.circle.around(place, abs(item.p3), item.p3 >= 0.0)
            self.part = Part.CIRCLE
        elif command == DELAY:
            self._delay(item)
        elif command == GUIDED_ENABLE:
            self._hand_over(item)
        elif command == SET_YAW_SPEED:
            self._head(item)
        else:
            return self._conditions.begin(item, self.rover.now) or self._do(item)
        self._note_mission()
        return True

    def _place(self, item: Item) -> Point:
        s = self.rover.sense
        north, east, _ = self.rover.place_of(item, (s.north, s.east, s.down))
        return north, east

    def _go(self, item: Item, *, stops: bool) -> None:
        rover = self.rover
        place = self._place(item)
        self._stay, self._there_at = int(item.p1) if item.p1 < 32768 else 0, None
        onward: Point | None = None
        following = rover.mission.next_navigation(item.seq + 1)
        if not stops and not self._stay and following is not None:
            north, east, _ = rover.place_of(following, (place[0], place[1], rover.sense.down))
            onward = north, east
        rover.travel.go(place, onward)
        self.part = Part.WAY

    def _delay(self, item: Item) -> None:
        rover = self.rover
        self.part = Part.STOP
        seconds = delay(item, rover.unix_s())
        self._delay_end = rover.now + seconds
        rover.say(INFO, f"Delaying {int(seconds)} sec")

    def _hand_over(self, item: Item) -> None:
        if item.p1 <= 0:
            return
        rover = self.rover
        rover.guided.enter()
        rover.guided.begin_limits()
        self.part = Part.GUIDED
        self._guided_to = None if item.here else self._place(item)

    def _head(self, item: Item) -> None:
        most = self.rover.params["WP_SPEED"]
        yaw = math.radians(item.p1)
        self._yaw = wrap(self.rover.sense.yaw + yaw if item.p3 > 0 else yaw)
        self._speed = min(max(item.p2, -most), most)
        self._headed = False
        self.part = Part.HEADING

    def _do(self, item: Item) -> bool:
        """Commands that are done as soon as they are begun."""
        rover = self.rover
        if item.command == CHANGE_SPEED:
            if self.set_speed(item.p2):
                rover.say(INFO, f"speed: {item.p2:.1f} m/s")
        elif item.command == SET_HOME:
            rover.move_home(None if item.p1 == 1 else rover.place_of(item, None))
        elif item.command in REGIONS:
            rover.region_of_interest(None if item.here and item.z == 0 else rover.place_of(item, None))
        elif item.command == REVERSE:
            rover.travel.reversed = item.p1 == 1
        elif item.command == GUIDED_LIMITS:
            rover.guided.limit(item.p1, item.p4)
        else:
            return rover.payload.perform(item)
        return True

    def verify(self, item: Item) -> bool:
        if item.command in UNREPORTED:
            return True
        done = self._is_done(item)
        if done:
            self.rover.reached(item.seq)
        return done

    def _is_done(self, item: Item) -> bool:
        rover, command = self.rover, item.command
        if command in (WAYPOINT, LOITER_UNLIM, LOITER_TIME):
            stayed = self._stayed(item)
            if stayed and command == LOITER_TIME:
                rover.say(WARNING, "Finished active loiter")
            return stayed and command != LOITER_UNLIM
        if command == RTL:
            return self.part is not Part.RTL or rover.rtl.reached
        if command == LOITER_TURNS:
            return self.circle.angle / (2.0 * math.pi) >= item.p1
        if command == DELAY:
            return rover.now > self._delay_end
        if command == GUIDED_ENABLE:
            return self._guided_done(item)
        if command == SET_YAW_SPEED:
            return self._headed
        if command not in KNOWN:
            rover.say(WARNING, f"Skipping invalid cmd #{command}")
        return self._conditions.met(item, rover.now, self.distance)

    def _stayed(self, item: Item) -> bool:
        """Reached, and stayed there as long as it was told."""
        rover = self.rover
        if not rover.travel.reached:
            return False
        if self._there_at is None:
            self._there_at = rover.now
            more = f". Loiter for {self._stay} seconds" if self._stay else ""
            rover.say(INFO, f"Reached waypoint #{item.seq}{more}")
        return int(rover.now - self._there_at) >= self._stay

    def _guided_done(self, item: Item) -> bool:
        rover = self.rover
        if self.part is not Part.GUIDED or item.p1 == 0:
            return True
        if self._guided_to is not None and math.dist(self._guided_to, rover.travel.here) <= rover.params["WP_RADIUS"]:
            return True
        return rover.guided.limits_breached

    def finished(self) -> None:
        """The end of the mission: what MIS_DONE_BEHAVE says."""
        rover = self.rover
        rover.say(NOTICE, "Mission Complete")
        behaviour = int(rover.params["MIS_DONE_BEHAVE"])
        if behaviour in _MODES and rover.set_mode(_MODES[behaviour]):
            return
        self.part = Part.STOP
        if behaviour == LOITER:
            rover.loiter.enter()
            self.part = Part.LOITER
