"""AUTO: drives the mission, as ArduRover does: https://ardupilot.org/rover/docs/auto-mode.html"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.mode import AutoMode
from zmav.sim.autopilots.ardurover.modes import RoverMode
from zmav.sim.autopilots.items import Item
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardurover.rover import ArduRover

CRITICAL, WARNING, NOTICE, INFO = 2, 4, 5, 6
WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL = 16, 17, 19, 20  # MAV_CMD
LOITER, MANUAL = 1, 3  # MIS_DONE_BEHAVE; else it holds


class Part(enum.Enum):
    """What it does now."""

    STOP = "stop"
    WAY = "way"
    RTL = "rtl"
    LOITER = "loiter"


class Auto(RoverMode, AutoMode):
    """Also the mission's performer."""

    number, name, autopilot, changes_speed = 10, "AUTO", True, True
    NAVIGATION = (WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL)

    def __init__(self, rover: ArduRover) -> None:
        super().__init__(rover)
        self.part = Part.STOP
        self._waiting = False
        self._changes = 0
        self._driven: tuple[Item, ...] = ()
        self._stay = 0
        self._there_at: float | None = None

    # ---- the mode

    def blocked(self) -> str:
        if self.rover.mission.present:
            return ""
        self.rover.say(NOTICE, "No Mission. Can't set AUTO.")
        return "there is no mission"

    def enter(self) -> None:
        self.rover.travel.begin()
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
        elif self.part is Part.RTL:
            rover.rtl.update()
        elif self.part is Part.LOITER:
            rover.loiter.update()
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

    # ---- what it tells: as the part that it drives now

    @property
    def _as(self) -> RoverMode | None:
        rover = self.rover
        parts: dict[Part, RoverMode] = {Part.RTL: rover.rtl, Part.LOITER: rover.loiter}
        return parts.get(self.part)

    @property
    def place(self) -> Vector | None:
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
        if self.part in (Part.WAY, Part.STOP):
            return self.rover.travel.change_speed(speed)
        return self._as is not None and self._as.set_speed(speed)

    # ---- the mission's performer

    def set_out(self, item: Item) -> None:
        if item.command == RTL:
            self.rover.rtl.enter()
            self.part = Part.RTL
        else:
            self._go(item, stops=item.command != WAYPOINT)
        self._note_mission()

    def change_speed(self, item: Item) -> None:
        if self.set_speed(item.p2):
            self.rover.say(INFO, f"speed: {item.p2:.1f} m/s")

    def _go(self, item: Item, *, stops: bool) -> None:
        rover = self.rover
        s = rover.sense
        place: Point = rover.place_of(item, (s.north, s.east, s.down))[:2]
        self._stay, self._there_at = int(item.p1) if item.p1 < 32768 else 0, None
        onward: Point | None = None
        following = rover.mission.next_navigation(item.seq + 1)
        if not stops and not self._stay and following is not None:
            north, east, _ = rover.place_of(following, (place[0], place[1], rover.sense.down))
            onward = north, east
        rover.travel.go(place, onward)
        self.part = Part.WAY

    def arrived(self, item: Item) -> bool:
        rover = self.rover
        if item.command == RTL:
            return self.part is not Part.RTL or rover.rtl.reached
        stayed = self._stayed(item)
        if stayed and item.command == LOITER_TIME:
            rover.say(WARNING, "Finished active loiter")
        return stayed and item.command != LOITER_UNLIM

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

    def finished(self) -> None:
        """The end of the mission: what MIS_DONE_BEHAVE says."""
        rover = self.rover
        rover.say(NOTICE, "Mission Complete")
        behaviour = int(rover.params["MIS_DONE_BEHAVE"])
        if behaviour == MANUAL and rover.set_mode(0):
            return
        self.part = Part.STOP
        if behaviour == LOITER:
            rover.loiter.enter()
            self.part = Part.LOITER
