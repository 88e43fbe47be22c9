"""The MAVLink face of an ArduPlane: the commands and targets that it takes in its own way.

https://ardupilot.org/dev/docs/plane-commands-in-guided-mode.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from zmav.sim.autopilots.ardupilot.vehicle import INFO, WARNING
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.protocol.ardupilot.commands import (
    ACCEPTED,
    COMMAND_INT_ONLY,
    DENIED,
    FAILED,
    Command,
    Handlers,
    place,
    verdict,
)
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.planereports import REPORTS
from zmav.sim.protocol.part import Answer
from zmav.sim.protocol.reports import Report

_AUTO, _RTL, _LOITER = 10, 11, 12
_CHANGE_MODE = 1  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
_ABSOLUTE, _RELATIVE = (0, 5), (3, 6, 10, 11)  # MAV_FRAME
_LOCAL_OFFSET = 7
_AIRSPEED = 0  # SPEED_TYPE
_COURSE, _HEADING, _CIRCLE = 0, 1, 2  # HEADING_TYPE
_IGNORE_HEIGHT = 4  # POSITION_TARGET_TYPEMASK
_NO_ROLL, _NO_PITCH, _NO_YAW, _NO_THRUST, _NO_ATTITUDE = 1, 2, 4, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_HIGHEST = 80_000.0  # m


def _plane(node: MavNode) -> ArduPlane:
    assert isinstance(node.vehicle, ArduPlane)
    return node.vehicle


def _down(plane: ArduPlane, altitude: float, frame: int) -> float | None:
    """An altitude of a MAV_FRAME in metres down of the world's origin; None for a frame without one."""
    if not abs(altitude) < _HIGHEST:
        return None
    if frame in _RELATIVE:
        return plane.home_world[2] - altitude
    return plane.world.alt_amsl_m - altitude if frame in _ABSOLUTE else None


# ---- commands


def _go(number: int) -> Any:
    """A change of mode that is acknowledged whether it works or not, as ArduPlane does."""

    def handler(node: MavNode, c: Command) -> int:
        node.vehicle.set_mode(number)
        return ACCEPTED

    return handler


def _takeoff(node: MavNode, c: Command) -> int:
    """For planes that hover."""
    return FAILED


def _mission_start(node: MavNode, c: Command) -> int:
    if c.p1 or c.p2:
        return DENIED
    node.vehicle.set_mode(_AUTO)
    return ACCEPTED


def _change_speed(node: MavNode, c: Command) -> int:
    plane = _plane(node)
    if not plane.mode.changes_speed:
        return FAILED
    values = (c.p1, c.p2, c.p3)
    return verdict(all(map(math.isfinite, values)) and plane.ask_speed(int(c.p1), c.p2, c.p3))


def _reposition(node: MavNode, c: Command) -> int:
    if not c.as_int:
        return COMMAND_INT_ONLY
    plane = _plane(node)
    where = place(node, c.x, c.y, c.z, c.frame)
    if where is None or (c.x == 0 and c.y == 0) or not plane.fence.allows(where):
        return DENIED
    change = math.isfinite(c.p2) and int(c.p2) & _CHANGE_MODE
    if plane.mode is not plane.guided and not change:
        return FAILED
    if not plane.set_mode(plane.guided.number):
        return FAILED
    radius = c.p3 if math.isfinite(c.p3) and c.p3 > 0 else 0.0
    plane.guided.fly_to(where, radius, counter_clockwise=math.isfinite(c.p4) and c.p4 != 0)
    return ACCEPTED


def _change_altitude(node: MavNode, c: Command) -> int:
    """DO_CHANGE_ALTITUDE: ``p1`` metres, ``p2`` the frame; for the place it goes to, in any mode."""
    plane = _plane(node)
    down = _down(plane, c.p1, int(c.p2))
    if down is None:
        return DENIED
    plane.way.end = *plane.way.end[:2], down
    plane.way.level()
    return ACCEPTED


def _guided_speed(node: MavNode, c: Command) -> int:
    plane = _plane(node)
    if plane.mode is not plane.guided:
        return FAILED
    if int(c.p1) != _AIRSPEED:
        return DENIED
    rate = c.p3 if math.isfinite(c.p3) else 0.0
    return verdict(plane.guided.change_airspeed(c.p2, rate))


def _guided_altitude(node: MavNode, c: Command) -> int:
    plane = _plane(node)
    if plane.mode is not plane.guided:
        return FAILED
    down = _down(plane, c.z, c.frame)
    if down is None or c.z in (-1.0, 0.0):
        return DENIED
    rate = abs(c.p3) if math.isfinite(c.p3) else 0.0
    plane.guided.change_height(down, rate)
    return ACCEPTED


def _guided_heading(node: MavNode, c: Command) -> int:
    plane = _plane(node)
    if plane.mode is not plane.guided:
        return FAILED
    if not 0.0 <= c.p2 < 360.0 or int(c.p1) not in (_COURSE, _HEADING, _CIRCLE):
        return DENIED
    if int(c.p1) == _CIRCLE:
        plane.guided.change_heading(None)
    else:
        accel = c.p3 if math.isfinite(c.p3) else 0.0
        plane.guided.change_heading(math.radians(c.p2), course=int(c.p1) == _COURSE, accel=accel)
    return ACCEPTED


def _land_start(node: MavNode, c: Command) -> int:
    plane = _plane(node)
    return verdict(plane.position_ok and plane.land_by_mission())


def _go_around(node: MavNode, c: Command) -> int:
    """Give up a landing: back to the approach."""
    plane = _plane(node)
    if plane.mode is not plane.auto or not plane.auto.is_landing or plane.auto.previous is None:
        return FAILED
    return verdict(plane.mission.set_current(plane.auto.previous.seq))


COMMANDS: Handlers = {
    17: _go(_LOITER),  # NAV_LOITER_UNLIM
    20: _go(_RTL),  # NAV_RETURN_TO_LAUNCH
    22: _takeoff,
    178: _change_speed,
    186: _change_altitude,
    189: _land_start,
    191: _go_around,
    192: _reposition,
    300: _mission_start,
    43000: _guided_speed,
    43001: _guided_altitude,
    43002: _guided_heading,
}


# ---- targets


def _local_target(node: MavNode, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_LOCAL_NED: only so many metres down from here."""
    plane = _plane(node)
    if plane.mode is not plane.guided or msg["coordinate_frame"] != _LOCAL_OFFSET or not abs(msg["z"]) < _HIGHEST:
        return
    plane.guided.change_height(plane.way.end[2] + msg["z"])
    node.say(INFO, f"Change alt to {plane.home_world[2] - plane.way.end[2]:.1f}")


def _global_target(node: MavNode, msg: dict[str, Any]) -> None:
    """Apply a SET_POSITION_TARGET_GLOBAL_INT: only its altitude."""
    plane = _plane(node)
    if plane.mode is not plane.guided:
        return
    if msg["coordinate_frame"] not in (*_ABSOLUTE, *_RELATIVE):
        node.say(WARNING, "Invalid coord frame in SET_POSTION_TARGET_GLOBAL_INT")
        return
    down = _down(plane, msg["alt"], msg["coordinate_frame"])
    if not msg["type_mask"] & _IGNORE_HEIGHT and down is not None:
        plane.guided.change_height(down)


def _attitude_target(node: MavNode, msg: dict[str, Any]) -> None:
    """Apply a SET_ATTITUDE_TARGET: of the attitude the angles whose rate is not ignored, or all with none; a yaw is
    taken for rudder.
    """
    plane, mask, (w, x, y, z) = _plane(node), msg["type_mask"], msg["q"]
    if plane.mode is not plane.guided:
        return
    if not all(math.isfinite(part) for part in (w, x, y, z, msg["thrust"])):
        return
    whole = mask & (_NO_ROLL | _NO_PITCH | _NO_YAW) == (_NO_ROLL | _NO_PITCH | _NO_YAW) and not mask & _NO_ATTITUDE
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    plane.guided.force(
        roll=roll if whole or not mask & _NO_ROLL else None,
        pitch=pitch if whole or not mask & _NO_PITCH else None,
        rudder=min(max(yaw / math.radians(45.0), -1.0), 1.0) if whole or not mask & _NO_YAW else None,
        throttle=None if mask & _NO_THRUST else msg["thrust"],
    )


class PlaneNode(MavNode):
    """Speaks for one :class:`ArduPlane`."""

    HANDLERS: ClassVar[Handlers] = {**MavNode.HANDLERS, **COMMANDS}
    REPORTS: ClassVar[Mapping[str, Report]] = {**MavNode.REPORTS, **REPORTS}

    def _own_answers(self) -> dict[str, Answer]:
        return {
            **super()._own_answers(),
            "SET_POSITION_TARGET_LOCAL_NED": lambda ch, m, who: _local_target(self, m),
            "SET_POSITION_TARGET_GLOBAL_INT": lambda ch, m, who: _global_target(self, m),
            "SET_ATTITUDE_TARGET": lambda ch, m, who: _attitude_target(self, m),
        }
