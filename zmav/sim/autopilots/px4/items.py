"""PX4's lists of items: missions, fences and rally points, each replaced as a whole; and its geofence.

A list that is being uploaded takes the place of the old one when its last item has come, and not before. There is no
item for home. https://docs.px4.io/v1.16/en/advanced/mission_parameters.html,
https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import ClassVar, NamedTuple

import msgspec

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.items import FENCE, MISSION, RALLY, Area, Item, WholeList, areas_of, check_place
from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.control.setpoints import Vector

ABSOLUTE, RELATIVE, MISSION_FRAME = (0, 5), (3, 6), 2  # MAV_FRAME
_NAVIGATION = {16, 17, 19, 20, 21, 22, 93}  # MAV_CMD: waypoint, loiters, return, land, takeoff, delay
# Delays, jump, speed, home, actuator, ROI, camera, gimbal and others: kept, though some of them do nothing here.
_ACTIONS = {
    *(112, 114, 177, 178, 179, 187, 189, 195, 196, 197, 200, 201, 203, 204, 205, 206, 211, 214, 260, 530, 532, 534),
    *(1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000),
}
_PLACED = {16, 17, 19, 21, 22, 195, 201}  # what a global frame is for; every other command has MAV_FRAME_MISSION
_FENCES = {5001, 5002, 5003, 5004}
_NO_PLACE = 2**31 - 1


class Px4Items(WholeList):
    """One list; ``opaque_id`` is zero for an empty one, and another for every other list."""

    known: ClassVar[set[int]]
    placed: ClassVar[set[int]]
    opaque_id = 0

    def kept(self, item: Item) -> Item | MissionResult:
        verdict = self._judge(item)
        return msgspec.structs.replace(item, current=0) if verdict is MissionResult.ACCEPTED else verdict

    def changed(self) -> None:
        sums = 0
        for i in self.items:
            numbers = struct.pack("<HB4dqqd", i.command, i.frame, i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z)
            sums = zlib.crc32(numbers, sums)
        self.opaque_id = (sums or 1) if self.items else 0

    def _judge(self, item: Item) -> MissionResult:
        if item.command not in self.known:
            return MissionResult.UNSUPPORTED
        if item.frame not in (*ABSOLUTE, *RELATIVE, MISSION_FRAME):
            return MissionResult.UNSUPPORTED_FRAME
        if item.frame == MISSION_FRAME:
            # An action: x, y and z are parameters like the others, NaN where not used. "No region of interest" is one.
            return MissionResult.UNSUPPORTED if item.command in self.placed - {201} else MissionResult.ACCEPTED
        if item.command not in self.placed:
            return MissionResult.UNSUPPORTED
        if not math.isfinite(item.z):
            return MissionResult.INVALID_PARAM7
        return check_place(item) if item.x != _NO_PLACE else MissionResult.ACCEPTED


class MissionItems(Px4Items):
    kind, title, most = MISSION, "Mission", 500
    known: ClassVar[set[int]] = _NAVIGATION | _ACTIONS
    placed: ClassVar[set[int]] = _PLACED


class FenceItems(Px4Items):
    """Kept and given back; :class:`Fence` acts on its areas."""

    kind, title, most = FENCE, "Fence", 64
    known: ClassVar[set[int]] = _FENCES
    placed: ClassVar[set[int]] = _FENCES


class RallyItems(Px4Items):
    """Kept and given back; RTL flies home."""

    kind, title, most = RALLY, "Rally", 50
    known: ClassVar[set[int]] = {5100}
    placed: ClassVar[set[int]] = {5100}


class Breach(NamedTuple):
    """Which of its parts are breached."""

    distance: bool = False
    height: bool = False
    area: bool = False

    def __bool__(self) -> bool:
        return self.distance or self.height or self.area


class Fence:
    """One vehicle's geofence: a cylinder about home (GF_MAX_HOR_DIST, GF_MAX_VER_DIST), and the plan's polygons and
    circles. https://docs.px4.io/v1.16/en/flying/geofence.html. An area that home, or a flying vehicle, is on the wrong
    side of is not taken. GF_ACTION says what happens at a breach, which is looked for five times a second, at where the
    vehicle is (GF_PREDICT 0). ``breach`` is what was found lately.
    """

    def __init__(self, copter: Px4State, items: FenceItems) -> None:
        self._copter, self._items = copter, items
        self._areas: tuple[Area, ...] = ()
        self._known = 0
        self.breach = Breach()

    def renew(self) -> None:
        """Take the areas of the plan, where it has changed."""
        items = self._items
        if self._known != items.opaque_id:
            self._known = items.opaque_id
            self._areas = tuple(area for area in areas_of(items.items, self._copter.world) if self._fits(area))

    def _fits(self, area: Area) -> bool:
        copter = self._copter
        if copter.has_home and area.outside_by(*copter.home_world[:2]) > 0.0:
            copter.tell(events.FENCE_WITHOUT_HOME)
            return False
        sense = copter.sense
        if copter.params["GF_ACTION"] and not copter.landed and area.outside_by(sense.north, sense.east) > 0.0:
            copter.tell(events.FENCE_WITHOUT_VEHICLE)
            return False
        return True

    def at(self, place: Vector) -> Breach:
        """What a vehicle there, in the world's NED, would breach."""
        copter, p = self._copter, self._copter.params
        north, east, down = copter.home_world
        farthest, highest = p["GF_MAX_HOR_DIST"], p["GF_MAX_VER_DIST"]
        return Breach(
            copter.has_home and farthest > 0.0 and math.hypot(place[0] - north, place[1] - east) >= farthest,
            copter.has_home and highest > 0.0 and down - place[2] >= highest,
            any(area.outside_by(place[0], place[1]) > 0.0 for area in self._areas),
        )

    @property
    def acts(self) -> bool:
        """It is breached, and that is no matter of indifference."""
        return bool(self.breach) and int(self._copter.params["GF_ACTION"]) != 0

    def update(self) -> None:
        """Look where the vehicle is."""
        self.renew()
        copter, sense = self._copter, self._copter.sense
        p = copter.params
        if not (self._areas or p["GF_MAX_HOR_DIST"] > 0.0 or p["GF_MAX_VER_DIST"] > 0.0):
            self.breach = Breach()
        elif copter.position_ok:
            self.breach = self.at((sense.north, sense.east, sense.down))
