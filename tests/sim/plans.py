"""Mission items for the simulator's tests, and their upload and download over a ground station's link."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from zmav.sim.geo import METRES_PER_DEGREE

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs

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


def upload(gcs: Gcs, items: Sequence[Fields], kind: int = 0, *, home: bool = True) -> int:
    """Upload as a ground station does, a mission with home before it; gives the MAV_MISSION_RESULT."""
    items = [HOME, *items] if kind == 0 and home else list(items)
    gcs.clear("MISSION_REQUEST")
    gcs.clear("MISSION_ACK")
    gcs.send("MISSION_COUNT", count=len(items), mission_type=kind)
    while not gcs.all("MISSION_ACK"):
        asked = gcs.all("MISSION_REQUEST")
        assert asked, "nothing was asked for"
        gcs.clear("MISSION_REQUEST")
        seq = asked[-1]["seq"]
        gcs.send("MISSION_ITEM_INT", seq=seq, mission_type=kind, **items[seq])
    return int(gcs.all("MISSION_ACK")[-1]["type"])


def download(gcs: Gcs, kind: int = 0) -> list[Fields]:
    """Every item that is there."""
    gcs.clear("MISSION_COUNT")
    gcs.send("MISSION_REQUEST_LIST", mission_type=kind)
    count = gcs.all("MISSION_COUNT")[-1]["count"]
    gcs.clear("MISSION_ITEM_INT")
    for seq in range(count):
        gcs.send("MISSION_REQUEST_INT", seq=seq, mission_type=kind)
    found = gcs.all("MISSION_ITEM_INT")
    assert [item["seq"] for item in found] == list(range(count))
    return found


def reached(gcs: Gcs) -> list[int]:
    return [m["seq"] for m in gcs.all("MISSION_ITEM_REACHED")]


def fly(gcs: Gcs, items: Sequence[Fields]) -> None:
    """Upload, arm in GUIDED and start the mission."""
    gcs.until(lambda: gcs.vehicle.copter.position_ok)
    assert upload(gcs, items) == 0
    assert gcs.command(176, 1, 4) == 0
    assert gcs.command(400, 1) == 0
    assert gcs.command(300) == 0
