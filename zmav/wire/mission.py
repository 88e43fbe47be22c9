"""Missions, geofences and rally points, as MAVLink's mission protocol has them: https://mavlink.io/en/services/mission.html"""

from __future__ import annotations

from typing import Literal

from zmav.wire.base import Vector, Wire
from zmav.wire.orders import Forced, Order

MissionKind = Literal["mission", "fence", "rally"]


class MissionItem(Wire, kw_only=True):
    """One item. ``x`` and ``y``: degrees of latitude and longitude in the global frames, metres in the local ones."""

    command: str
    """MAV_CMD name: ``MAV_CMD_NAV_WAYPOINT``"""
    frame: str = "MAV_FRAME_GLOBAL_RELATIVE_ALT"
    params: list[float | None] = []
    """param1 to param4; None is NaN; what is missing is 0"""
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    """metres"""
    autocontinue: bool = True


class Mission(Wire, kw_only=True):
    """A plan of one kind. For ArduPilot's missions item 0 is home, and is left out here: the vehicle puts it in."""

    kind: MissionKind = "mission"
    items: list[MissionItem] = []
    home: Vector | None = None
    """item 0 as it is on an ArduPilot: degrees of latitude and longitude, metres above mean sea level"""
    id: int | None = None
    """MAVLink's opaque id of the plan on the autopilot, where it gives one"""
    current: int | None = None
    """index of the item being flown (kind mission)"""
    reached: int | None = None
    """index of the last item reached"""
    state: str | None = None
    """MISSION_STATE without its prefix, where the autopilot tells"""


class MissionUpload(Forced, kw_only=True):
    """``do/mission_upload``: replaces the whole plan of that kind, or leaves the old one in force and says why. While
    the vehicle is armed, a mission is held to its bounds.
    """

    kind: MissionKind = "mission"
    items: list[MissionItem]


class MissionClear(Order, kw_only=True):
    """``do/mission_clear``."""

    kind: MissionKind = "mission"


class MissionRefresh(Order, kw_only=True):
    """``do/mission_download``: read the plan again from the autopilot into the cache behind ``mission/{kind}``."""

    kind: MissionKind = "mission"


class MissionStart(Forced, kw_only=True):
    """``do/mission_start``: fly the mission from item ``first`` on; ``wait_end``: done at its last item."""

    first: int = 0
    wait_end: bool = False


class MissionJump(Forced, kw_only=True):
    """``do/mission_current``: go on with item ``index``."""

    index: int
