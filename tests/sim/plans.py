"""Mission items for the simulator's tests, and their upload and download over a desk's link."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from zmav.sim.geo import METRES_PER_DEGREE

if TYPE_CHECKING:
    from tests.sim.conftest import Desk

Fields = dict[str, Any]
HOME_LAT, HOME_LON = -35.363261, 149.165230
RELATIVE, ABSOLUTE, NO_FRAME = 6, 0, 2
HOME: Fields = {"command": 16, "frame": ABSOLUTE}


def degrees(north: float, east: float) -> tuple[int, int]:
    """A place about the worlds' home, metres, as degrees times 1e7."""
    per_degree = METRES_PER_DEGREE * math.cos(math.radians(HOME_LAT))
    return round((HOME_LAT + north / METRES_PER_DEGREE) * 1e7), round((HOME_LON + east / per_degree) * 1e7)


def at(command: int, north: float, east: float, up: float = 0.0, *params: float, frame: int = RELATIVE) -> Fields:
    """An item at a place."""
    x, y = degrees(north, east)
    return {"command": command, "frame": frame, "x": x, "y": y, "z": up, **_params(params)}


def do(command: int, *params: float, z: float = 0.0) -> Fields:
    """An item without a place."""
    return {"command": command, "frame": NO_FRAME, "z": z, **_params(params)}


def takeoff(up: float) -> Fields:
    return {"command": 22, "frame": RELATIVE, "z": up}


def _params(params: Sequence[float]) -> Fields:
    return {f"param{i}": float(p) for i, p in enumerate(params, start=1)}


def upload(desk: Desk, items: Sequence[Fields], kind: int = 0, *, home: bool = True) -> int:
    """Upload as a ground station does, a mission with home before it; gives the MAV_MISSION_RESULT."""
    items = [HOME, *items] if kind == 0 and home else list(items)
    desk.clear("MISSION_REQUEST")
    desk.clear("MISSION_ACK")
    desk.send("MISSION_COUNT", count=len(items), mission_type=kind)
    while not desk.all("MISSION_ACK"):
        asked = desk.all("MISSION_REQUEST")
        assert asked, "nothing was asked for"
        desk.clear("MISSION_REQUEST")
        seq = asked[-1]["seq"]
        desk.send("MISSION_ITEM_INT", seq=seq, mission_type=kind, **items[seq])
    return int(desk.all("MISSION_ACK")[-1]["type"])


def download(desk: Desk, kind: int = 0) -> list[Fields]:
    """Every item that is there."""
    desk.clear("MISSION_COUNT")
    desk.send("MISSION_REQUEST_LIST", mission_type=kind)
    count = desk.all("MISSION_COUNT")[-1]["count"]
    desk.clear("MISSION_ITEM_INT")
    for seq in range(count):
        desk.send("MISSION_REQUEST_INT", seq=seq, mission_type=kind)
    found = desk.all("MISSION_ITEM_INT")
    assert [item["seq"] for item in found] == list(range(count))
    return found


def reached(desk: Desk) -> list[int]:
    return [m["seq"] for m in desk.all("MISSION_ITEM_REACHED")]


def fly(desk: Desk, items: Sequence[Fields]) -> None:
    """Upload, arm in GUIDED and start the mission."""
    desk.until(lambda: desk.vehicle.copter.position_ok)
    assert upload(desk, items) == 0
    assert desk.command(176, 1, 4) == 0
    assert desk.command(400, 1) == 0
    assert desk.command(300) == 0
