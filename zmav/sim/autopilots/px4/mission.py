"""MISSION: flies the items of the mission one after the other, and holds after the last.

https://docs.px4.io/v1.16/en/flight_modes_mc/mission.html
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from zmav.sim.autopilots.items import Item
from zmav.sim.autopilots.px4.items import RELATIVE, MissionItems
from zmav.sim.autopilots.px4.modes import HOLD, MISSION, RTL
from zmav.sim.control.setpoints import Vector
from zmav.sim.geo import Position, to_ned

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

_WAYPOINT, _LOITER, _LOITER_TIME, _RETURN, _LAND, _TAKEOFF, _DELAY, _JUMP, _SPEED = 16, 17, 19, 20, 21, 22, 93, 177, 178
_TRAVELS = {_WAYPOINT, _LOITER, _LOITER_TIME, _LAND, _TAKEOFF, _DELAY}
_NO_PLACE = 2**31 - 1
_LOW_M = 1.0  # above home: from there it rises straight up first
_MOST_STEPS = 50  # items without a way to fly that are worked off at once: jumps may go round in circles


class Mission:
    """One vehicle's mission; ``current`` is the item that flies, or will when MISSION is entered."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self.items = MissionItems()
        self.current = 0
        self.finished = False
        self.landing = False
        self.reached: Callable[[int], None] = lambda seq: None
        self._known = 0
        self._start: Vector | None = None  # of the item that flies
        self._there_since: float | None = None
        self._jumps: dict[int, int] = {}

    @property
    def able(self) -> bool:
        """There is something to fly."""
        return len(self.items) > 0

    @property
    def state(self) -> int:
        """MISSION_STATE: complete, active, paused, not started."""
        if self.finished:
            return 5
        if self._copter.mode is MISSION and self._copter.armed:
            return 3
        return 4 if self.current else 2

    def renew(self) -> None:
        """Start from the beginning where the list has changed."""
        if self._known != self.items.opaque_id:
            self._known = self.items.opaque_id
            self.jump(0)

    def jump(self, seq: int) -> bool:
        """Make ``seq`` the current item; False where there is none such."""
        if not 0 <= seq < max(len(self.items), 1):
            return False
        self.current, self.finished = seq, False
        self._jumps.clear()
        self._begin()
        return True

    def enter(self) -> None:
        """MISSION is entered: go on where it was left, or begin again after its end."""
        self.renew()
        if self.finished:
            self.jump(0)
        self._begin()

    def _begin(self) -> None:
        self._start = self._there_since = None
        self.landing = False

    def fly(self) -> None:
        """One tick."""
        for _ in range(_MOST_STEPS):
            if self.current >= len(self.items):
                self._end()
                return
            item = self.items.items[self.current]
            if not self._step(item):
                return
        self._end()

    def _step(self, item: Item) -> bool:
        """Fly one item; True where the next one is to be looked at in the same tick."""
        copter = self._copter
        if item.command == _RETURN:
            self.current += 1
            copter.set_mode(RTL)
            return False
        if item.command == _JUMP:
            return self._jump_item(item)
        if item.command == _SPEED:
            copter.cruise_speed = item.p2 if item.p2 > 0 else None
        elif item.command in _TRAVELS and not self._travel(item):
            return False
        self._done()
        return True

    def _jump_item(self, item: Item) -> bool:
        done = self._jumps.get(self.current, 0)
        if done < item.p2 and 0 <= item.p1 < len(self.items):
            self._jumps[self.current] = done + 1
            self.current = int(item.p1)
            self._begin()
        else:
            self._done()
        return True

    def _travel(self, item: Item) -> bool:
        """On the way to an item, or waiting there; True when it is done."""
        copter, sense = self._copter, self._copter.sense
        if self._start is None:
            self._start = (sense.north, sense.east, sense.down)
        if item.command == _DELAY:
            return self._waited(item.p1)
        target = self._target(item)
        if item.command == _LAND:
            self._land(target)
            return False
        if item.command == _TAKEOFF or copter.home_world[2] - self._start[2] < _LOW_M:
            copter.sp.move(pos=(self._start[0], self._start[1], target[2]))
            if abs(sense.down - target[2]) > 0.8:
                return False
        yaw = math.radians(item.p4) if item.command == _WAYPOINT and math.isfinite(item.p4) and item.p4 else None
        there = copter.navigator.go(target, yaw)
        if item.command == _LOITER or not (there or self._there_since is not None):
            return False
        return self._waited(item.p1 if item.command in (_WAYPOINT, _LOITER_TIME) else 0.0)

    def _land(self, target: Vector) -> None:
        sense = self._copter.sense
        if self.landing or math.hypot(target[0] - sense.north, target[1] - sense.east) < 0.5:
            self.landing = True
            self._copter.navigator.descend()
        else:
            self._copter.navigator.go((target[0], target[1], self._start[2] if self._start else sense.down), None)

    def _waited(self, seconds: float) -> bool:
        now = self._copter.now
        self._there_since = now if self._there_since is None else self._there_since
        return now - self._there_since >= seconds

    def _target(self, item: Item) -> Vector:
        """The item's place in the world's NED; without a place of its own, where it began."""
        copter, start = self._copter, self._start or (0.0, 0.0, 0.0)
        if item.here or item.x == _NO_PLACE:
            north, east = start[0], start[1]
            down = to_ned(Position(copter.world.lat_deg, copter.world.lon_deg, item.z), copter.world)[2]
        else:
            north, east, down = to_ned(Position(item.x * 1e-7, item.y * 1e-7, item.z), copter.world)
        return north, east, copter.home_world[2] - item.z if item.frame in RELATIVE else down

    def _done(self) -> None:
        self.reached(self.current)
        self.current += 1
        self._begin()

    def touched_down(self) -> None:
        """The last item, a landing, is over."""
        if self.landing:
            self.reached(self.current)
            self.landing, self.finished = False, True
            self.current = max(len(self.items) - 1, 0)

    def _end(self) -> None:
        self.finished, self.current = True, max(len(self.items) - 1, 0)
        self._copter.set_mode(HOLD)
