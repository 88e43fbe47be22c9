"""Rally points: where ArduPilot may return to instead of home. https://ardupilot.org/copter/docs/common-rally-points.html"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from zmav.sim.autopilots import items
from zmav.sim.autopilots.ardupilot.plan import ABSOLUTE, RELATIVE, TERRAIN
from zmav.sim.autopilots.items import Item, ItemStore, Result, check_place
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

RALLY_POINT = 5100  # MAV_CMD_NAV_RALLY_POINT
HIGHEST_M = 32767.0


class Rally(ItemStore):
    """Points are kept as they arrive."""

    kind: ClassVar[int] = items.RALLY
    title: ClassVar[str] = "Rally"
    most: ClassVar[int] = 46

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self._items: list[Item] = []

    def __len__(self) -> int:
        return len(self._items)

    def read(self, seq: int) -> Item | Result:
        return self._items[seq] if seq < len(self._items) else Result.INVALID_SEQUENCE

    def open(self, count: int) -> Result:
        del self._items[count:]
        self._vehicle.sized("RALLY_TOTAL", len(self._items))
        return Result.ACCEPTED

    def put(self, item: Item, last: int) -> Result:
        if item.command != RALLY_POINT:
            return Result.UNSUPPORTED
        bad = check_place(item)
        if bad is not Result.ACCEPTED:
            return bad
        if not -HIGHEST_M - 1 <= item.z <= HIGHEST_M:
            return Result.INVALID_PARAM7
        frames = ((ABSOLUTE, 0), (RELATIVE, 3), (TERRAIN, 10))
        frame = next((kept for group, kept in frames if item.frame in group and item.frame != 2), None)
        if frame is None:
            return Result.UNSUPPORTED_FRAME
        kept = Item(
            command=RALLY_POINT, frame=frame, x=item.x, y=item.y, z=float(int(item.z)), seq=item.seq, autocontinue=0
        )
        if item.seq < len(self._items):
            self._items[item.seq] = kept
        else:
            self._items.append(kept)
            self._vehicle.sized("RALLY_TOTAL", len(self._items))
        return Result.ACCEPTED

    def clear(self) -> bool:
        self._items = []
        self._vehicle.sized("RALLY_TOTAL", 0)
        return True

    def nearest(self) -> Vector:
        """Where to return to from here: the nearest point within RALLY_LIMIT_KM, or home where that is nearer."""
        vehicle, s = self._vehicle, self._vehicle.sense
        home = vehicle.home_world
        points = [vehicle.place_of(item, home) for item in self._items]
        places = [point for point in points if vehicle.fence.allows(point)]
        if not places:
            return home
        best = min(places, key=lambda p: math.hypot(p[0] - s.north, p[1] - s.east))
        away = math.hypot(best[0] - s.north, best[1] - s.east)
        limit = vehicle.params["RALLY_LIMIT_KM"] * 1000.0
        if limit > 0 and away > limit:
            return home
        return best if not vehicle.params["RALLY_INCL_HOME"] or away < vehicle.from_home else home
