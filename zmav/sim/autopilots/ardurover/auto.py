"""AUTO: drives the mission, as ArduRover does: https://ardupilot.org/rover/docs/auto-mode.html"""

from __future__ import annotations

from zmav.sim.autopilots.ardupilot.state import INFO, NOTICE, WARNING, AutoMode
from zmav.sim.autopilots.ardurover.base import RoverBase
from zmav.sim.autopilots.ardurover.modes import Loiter, RoverMode, Rtl
from zmav.sim.autopilots.ardurover.travel import Travel
from zmav.sim.autopilots.items import Item
from zmav.sim.control.roversetpoints import Point
from zmav.sim.control.setpoints import Vector

WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL = 16, 17, 19, 20  # MAV_CMD
STAY, MANUAL = 1, 3  # MIS_DONE_BEHAVE; else it holds


class Auto(RoverMode, AutoMode):
    """Also the mission's performer."""

    number, name, autopilot, changes_speed = 10, "AUTO", True, True
    NAVIGATION = (WAYPOINT, LOITER_UNLIM, LOITER_TIME, RTL)

    def __init__(self, rover: RoverBase, travel: Travel, rtl: Rtl, loiter: Loiter) -> None:
        super().__init__(rover, travel)
        self._rtl, self._loiter = rtl, loiter
        self._under_way = False
        self._as: RoverMode | None = None
        """the mode that it drives as, once it is not under way by itself"""
        self._stay = 0
        self._there_at: float | None = None

    # ---- the mode

    def blocked(self) -> str:
        if self.rover.mission.present:
            return ""
        self.rover.say(NOTICE, "No Mission. Can't set AUTO.")
        return "there is no mission"

    def enter(self) -> None:
        self.travel.begin()
        self._under_way, self._as, self.waiting = False, None, True

    def update(self) -> None:
        rover = self.rover
        if not rover.armed and not rover.mission.present:
            self._under_way, self._as = False, None
        self.run_mission()
        if rover.mode is not self:
            return
        if self._as is not None:
            self._as.update()
        elif self._under_way:
            self.travel.update()
        else:
            rover.sp.stop()

    # ---- what it tells

    @property
    def place(self) -> Vector | None:
        if self._as is not None:
            return self._as.place
        place = self.travel.destination if self._under_way else None
        return None if place is None else self.at(place)

    @property
    def target(self) -> Vector | None:
        return self.place

    @property
    def cross_track(self) -> float:
        if self._as is not None:
            return self._as.cross_track
        return self.travel.cross_track if self._under_way else 0.0

    def set_speed(self, speed: float) -> bool:
        return self.travel.change_speed(speed) if self._as is None else self._as.set_speed(speed)

    # ---- the mission's performer

    def set_out(self, item: Item) -> None:
        if item.command == RTL:
            self._rtl.enter()
            self._as = self._rtl
        else:
            self._go(item, stops=item.command != WAYPOINT)

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
        self.travel.go(place, onward)
        self._under_way, self._as = True, None

    def arrived(self, item: Item) -> bool:
        rover = self.rover
        if item.command == RTL:
            return self._as is not self._rtl or self.travel.reached
        stayed = self._stayed(item)
        if stayed and item.command == LOITER_TIME:
            rover.say(WARNING, "Finished active loiter")
        return stayed and item.command != LOITER_UNLIM

    def _stayed(self, item: Item) -> bool:
        """Reached, and stayed there as long as it was told."""
        rover = self.rover
        if not self.travel.reached:
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
        self._under_way = False
        self._as = self._loiter if behaviour == STAY else None
        if self._as is not None:
            self._as.enter()
