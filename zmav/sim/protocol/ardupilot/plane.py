"""The MAVLink face of an ArduPlane: the commands and targets that it takes in its own way.

https://ardupilot.org/dev/docs/plane-commands-in-guided-mode.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from zmav import rotation
from zmav.sim.autopilots.ardupilot.vehicle import INFO, WARNING
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.protocol.ardupilot import duties
from zmav.sim.protocol.ardupilot.commands import Handlers, place
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.planereports import REPORTS
from zmav.sim.protocol.base import Handler, Report, Target
from zmav.sim.protocol.command import ACCEPTED, CHANGE_MODE, COMMAND_INT_ONLY, DENIED, FAILED, Command

_AUTO, _RTL, _LOITER = 10, 11, 12
_ABSOLUTE, _RELATIVE = (0, 5), (3, 6, 10, 11)  # MAV_FRAME
_LOCAL_OFFSET = 7
_IGNORE_HEIGHT = 4  # POSITION_TARGET_TYPEMASK
_NO_ROLL, _NO_PITCH, _NO_YAW, _NO_THRUST, _NO_ATTITUDE = 1, 2, 4, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_HIGHEST = 80_000.0  # m


def _down(plane: ArduPlane, altitude: float, frame: int) -> float | None:
    """An altitude of a MAV_FRAME in metres down of the world's origin; None for a frame without one."""
    if not abs(altitude) < _HIGHEST:
        return None
    if frame in _RELATIVE:
        return plane.home_world[2] - altitude
    return plane.world.alt_amsl_m - altitude if frame in _ABSOLUTE else None


# ---- commands


def _go(number: int) -> Handler:
    """A change of mode that is acknowledged whether it works or not, as ArduPlane does."""

    def handler(node: MavNode[ArduPlane], c: Command) -> int:
        node.vehicle.set_mode(number)
        return ACCEPTED

    return handler


def _mission_start(node: MavNode[ArduPlane], c: Command) -> int:
    if c.p1 or c.p2:
        return DENIED
    node.vehicle.set_mode(_AUTO)
    return ACCEPTED


def _change_speed(node: MavNode[ArduPlane], c: Command) -> int:
    plane = node.vehicle
    if not plane.mode.changes_speed:
        return FAILED
    values = (c.p1, c.p2, c.p3)
    return all(map(math.isfinite, values)) and plane.ask_speed(int(c.p1), c.p2, c.p3)


def _reposition(node: MavNode[ArduPlane], c: Command) -> int:
    if not c.as_int:
        return COMMAND_INT_ONLY
    plane = node.vehicle
    where = place(node, c.x, c.y, c.z, c.frame)
    if where is None or (c.x == 0 and c.y == 0) or not plane.fence.allows(where):
        return DENIED
    change = math.isfinite(c.p2) and int(c.p2) & CHANGE_MODE
    if plane.mode is not plane.guided and not change:
        return FAILED
    if not plane.set_mode(plane.guided.number):
        return FAILED
    radius = c.p3 if math.isfinite(c.p3) and c.p3 > 0 else 0.0
    plane.guided.fly_to(where, radius, counter_clockwise=math.isfinite(c.p4) and c.p4 != 0)
    return ACCEPTED


HANDLERS: Handlers = {
    **duties.HANDLERS,
    17: _go(_LOITER),  # NAV_LOITER_UNLIM
    20: _go(_RTL),  # NAV_RETURN_TO_LAUNCH
    22: lambda node, c: FAILED,  # NAV_TAKEOFF, for planes that hover
    178: _change_speed,
    192: _reposition,
    300: _mission_start,
}


# ---- targets


def _local_target(plane: ArduPlane, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_LOCAL_NED: only so many metres down from here."""
    if plane.mode is not plane.guided or msg["coordinate_frame"] != _LOCAL_OFFSET or not abs(msg["z"]) < _HIGHEST:
        return
    plane.guided.change_height(plane.way.end[2] + msg["z"])
    plane.say(INFO, f"Change alt to {plane.home_world[2] - plane.way.end[2]:.1f}")


def _global_target(plane: ArduPlane, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_GLOBAL_INT: only its altitude."""
    if plane.mode is not plane.guided:
        return
    if msg["coordinate_frame"] not in (*_ABSOLUTE, *_RELATIVE):
        plane.say(WARNING, "Invalid coord frame in SET_POSTION_TARGET_GLOBAL_INT")
        return
    down = _down(plane, msg["alt"], msg["coordinate_frame"])
    if not msg["type_mask"] & _IGNORE_HEIGHT and down is not None:
        plane.guided.change_height(down)


def _attitude_target(plane: ArduPlane, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET: of the attitude the angles whose rate is not ignored, or all with none; a yaw is
    taken for rudder.
    """
    mask = msg["type_mask"]
    if plane.mode is not plane.guided:
        return
    if not all(math.isfinite(part) for part in (*msg["q"], msg["thrust"])):
        return
    whole = mask & (_NO_ROLL | _NO_PITCH | _NO_YAW) == (_NO_ROLL | _NO_PITCH | _NO_YAW) and not mask & _NO_ATTITUDE
    roll, pitch, yaw = rotation.euler(msg["q"])
    plane.guided.force(
        roll=roll if whole or not mask & _NO_ROLL else None,
        pitch=pitch if whole or not mask & _NO_PITCH else None,
        rudder=min(max(yaw / math.radians(45.0), -1.0), 1.0) if whole or not mask & _NO_YAW else None,
        throttle=None if mask & _NO_THRUST else msg["thrust"],
    )


class PlaneNode(MavNode[ArduPlane]):
    """Speaks for one :class:`ArduPlane`."""

    HANDLERS: ClassVar[Handlers] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
    TARGETS: ClassVar[Mapping[str, Target]] = {
        "SET_POSITION_TARGET_LOCAL_NED": _local_target,
        "SET_POSITION_TARGET_GLOBAL_INT": _global_target,
        "SET_ATTITUDE_TARGET": _attitude_target,
    }
