"""Where MAV_CMDs and mission items lead a vehicle, so that the bounds of its field can be held against them.

Sources: https://mavlink.io/en/messages/common.html#mav_commands; ArduPilot's GCS_MAVLINK, which takes a COMMAND_LONG's
altitude for one above home; PX4's Commander, which takes a command's for one above the sea, whatever its frame says
(PX4-Autopilot issues 10246 and 28257), and a mission item's as its frame says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav.autopilots.base import HERE, Autopilot, Command, Target, commands

_TO_A_PLACE = commands(
    "DO_REPOSITION DO_ORBIT NAV_TAKEOFF NAV_VTOL_TAKEOFF NAV_WAYPOINT NAV_SPLINE_WAYPOINT NAV_LOITER_UNLIM "
    "NAV_LOITER_TURNS NAV_LOITER_TIME NAV_LOITER_TO_ALT NAV_PAYLOAD_PLACE NAV_FOLLOW OVERRIDE_GOTO NAV_RALLY_POINT"
)
LANDINGS = commands("NAV_LAND NAV_VTOL_LAND DO_LAND_START")
_TO_A_HEIGHT = commands("GUIDED_CHANGE_ALTITUDE NAV_CONTINUE_AND_CHANGE_ALT CONDITION_CHANGE_ALT")
_TO_A_SPEED = {"MAV_CMD_DO_CHANGE_SPEED": 1, "MAV_CMD_GUIDED_CHANGE_SPEED": 1, "MAV_CMD_NAV_SET_YAW_SPEED": 1}
"""and the index of the parameter that is it"""
_SPEEDS = {0: "speed", 1: "speed", 2: "climb", 3: "descend"}
"""SPEED_TYPE, which is the first parameter of the commands that have one"""
_ABOVE_THE_SEA = ("MAV_FRAME_GLOBAL", "MAV_FRAME_GLOBAL_INT")


SET_HOME = "MAV_CMD_DO_SET_HOME"


class Speed(NamedTuple):
    limit: str
    """speed, climb or descend"""
    value: float


def leads_to(command: Command, autopilot: Autopilot, *, in_mission: bool = False) -> Target | Speed | None:
    """What a command leads to; None: nowhere that a fence could tell.

    A place without an altitude is flown to at the present height, or is where it lands; an altitude without a place
    is flown to where the vehicle is. A height above the terrain is taken for one above home.
    """
    p = command.padded()
    if command.name in _TO_A_SPEED:
        kind = p[0] if command.name != "MAV_CMD_NAV_SET_YAW_SPEED" and math.isfinite(p[0]) else 0
        speed = p[_TO_A_SPEED[command.name]]
        return Speed(_SPEEDS.get(int(kind), "speed"), speed) if speed > 0.0 else None  # -1: as it is; -2: the usual one
    frame, ignored = command.frame or autopilot.command_frame, autopilot.ignores_frames and not in_mission
    if command.name == "MAV_CMD_DO_CHANGE_ALTITUDE":
        return Target(alt_amsl=p[0]) if ignored or p[1] in (0.0, 5.0) else Target(alt_rel=p[0])  # MAV_FRAME
    if not ignored and "GLOBAL" not in frame:
        return None
    height = Target(alt_amsl=p[6]) if ignored or frame in _ABOVE_THE_SEA else Target(alt_rel=p[6])
    if command.name in _TO_A_HEIGHT:
        return height
    if command.name not in _TO_A_PLACE | LANDINGS:
        return None
    if math.isnan(p[6]) or command.name in LANDINGS:
        height = Target()
    place = _place(command, autopilot)
    if place is None:
        return None if height == Target() else height
    return Target(*place, height.alt_amsl, height.alt_rel)


def home_by(command: Command, autopilot: Autopilot) -> Target | None:
    """The home that MAV_CMD_DO_SET_HOME names, its altitude above the sea where no frame says otherwise; None: where
    the vehicle is then.
    """
    p, frame = command.padded(), command.frame
    if p[0] == 1.0:
        return None
    lat, lon = (p[4] / 1e7, p[5] / 1e7) if frame else (p[4], p[5])
    if frame is None or frame in _ABOVE_THE_SEA or autopilot.ignores_frames:
        return Target(lat, lon, alt_amsl=p[6])
    return Target(lat, lon, alt_rel=p[6])


def _place(command: Command, autopilot: Autopilot) -> tuple[float, float] | None:
    """Latitude and longitude in degrees; None: where the vehicle is."""
    x, y = command.padded()[4:6]
    if math.isnan(x) or math.isnan(y) or (command.frame and HERE in (x, y)):
        return None
    if x == y == 0.0 and not autopilot.ignores_frames:
        return None  # as ArduPilot takes it; PX4 goes there
    return (x / 1e7, y / 1e7) if command.frame else (x, y)
