"""PX4's lists of items: missions, fences and rally points, each replaced as a whole.

A list that is being uploaded takes the place of the old one when its last item has come, and not before. There is no
item for home. https://docs.px4.io/v1.16/en/advanced/mission_parameters.html,
https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import ClassVar

import msgspec

from zmav.sim.autopilots.items import FENCE, MISSION, RALLY, Item, Result, WholeList, check_place

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

    def kept(self, item: Item) -> Item | Result:
        verdict = self._judge(item)
        return msgspec.structs.replace(item, current=0) if verdict is Result.ACCEPTED else verdict

    def changed(self) -> None:
        sums = 0
        for i in self.items:
            numbers = struct.pack("<HB4dqqd", i.command, i.frame, i.p1, i.p2, i.p3, i.p4, i.x, i.y, i.z)
            sums = zlib.crc32(numbers, sums)
        self.opaque_id = (sums or 1) if self.items else 0

    def _judge(self, item: Item) -> Result:
        if item.command not in self.known:
            return Result.UNSUPPORTED
        if item.frame not in (*ABSOLUTE, *RELATIVE, MISSION_FRAME):
            return Result.UNSUPPORTED_FRAME
        if item.frame == MISSION_FRAME:
            # An action: x, y and z are parameters like the others, NaN where not used. "No region of interest" is one.
            return Result.UNSUPPORTED if item.command in self.placed - {201} else Result.ACCEPTED
        if item.command not in self.placed:
            return Result.UNSUPPORTED
        if not math.isfinite(item.z):
            return Result.INVALID_PARAM7
        return check_place(item) if item.x != _NO_PLACE else Result.ACCEPTED


class MissionItems(Px4Items):
    kind, title, most = MISSION, "Mission", 500
    known: ClassVar[set[int]] = _NAVIGATION | _ACTIONS
    placed: ClassVar[set[int]] = _PLACED


class FenceItems(Px4Items):
    """Kept and given back; nothing acts on it."""

    kind, title, most = FENCE, "Fence", 64
    known: ClassVar[set[int]] = _FENCES
    placed: ClassVar[set[int]] = _FENCES


class RallyItems(Px4Items):
    """Kept and given back; RTL flies home."""

    kind, title, most = RALLY, "Rally", 50
    known: ClassVar[set[int]] = {5100}
    placed: ClassVar[set[int]] = {5100}
