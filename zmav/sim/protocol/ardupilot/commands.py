"""COMMAND_LONG and COMMAND_INT, with ArduPilot's verdicts; each kind adds its own.

Protocol: https://mavlink.io/en/services/command.html; which commands, and in which form:
https://ardupilot.org/dev/docs/mavlink-commands.html. What is not listed here is answered MAV_RESULT_UNSUPPORTED.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.ardupilot.mission import State
from zmav.sim.autopilots.ardupilot.state import Target
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.ardupilot.setpoint import point
from zmav.sim.protocol.base import SHARED_HANDLERS, Handler, send_message
from zmav.sim.protocol.channel import CHANGE_MODE, CUSTOM_MODE, FORCE, Command

_E7 = 1e7
_AUTO = 3
Handlers = Mapping[int, Handler]


def _set_mode(node: ArduNode, c: Command) -> int:
    if not int(c.p1) & CUSTOM_MODE:
        return CommandResult.DENIED
    done = node.vehicle.set_mode(int(c.p2))
    return CommandResult.UNSUPPORTED if int(c.p2) in node.vehicle.NOT_SIMULATED else done


def enter(number: int) -> Handler:
    """Answers a command that is a change of mode."""

    return lambda node, c: node.vehicle.set_mode(number)


def _request_version(node: ArduNode, c: Command) -> int:
    if c.p1 != 1:
        return CommandResult.DENIED
    return send_message(node, c, "AUTOPILOT_VERSION")


def _get_home(node: ArduNode, c: Command) -> int:
    if not node.vehicle.boot.has("origin"):
        return CommandResult.FAILED
    return send_message(node, c, "HOME_POSITION")


def _set_home(node: ArduNode, c: Command) -> int:
    x, y = (c.x, c.y) if c.as_int else (c.x * _E7, c.y * _E7)
    if c.p1 == 1 or (x == 0 and y == 0):
        return node.vehicle.move_home(None, lock=True)
    if c.p1 != 0:
        return CommandResult.FAILED
    where = place(node, x, y, c.z, c.frame if c.as_int else 0)
    return CommandResult.DENIED if where is None else node.vehicle.move_home(where, lock=True)


def place(node: ArduNode, x: float, y: float, z: float, frame: int) -> tuple[float, float, float] | None:
    """A place that a command names, in the world's NED; None for one that there is not."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return None
    return point(node.vehicle, round(x), round(y), z, frame)


Go = Callable[[Any, Command, Vector], bool]
"""Has GUIDED go to a place of the world's NED; False where it does not"""


def _aim(node: ArduNode, c: Command, where: Vector) -> bool:
    """The speed and yaw that the command can carry are not looked at."""
    node.vehicle.guided.aim(Target(pos=where))
    return True


def reposition(
    node: ArduNode,
    c: Command,
    go: Go = _aim,
    *,
    unasked: int = CommandResult.DENIED,
    outside: int = CommandResult.FAILED,
) -> int:
    """DO_REPOSITION; ``unasked``, ``outside``: the verdicts without the flag to enter GUIDED, and beyond the fence."""
    if not c.as_int:
        return CommandResult.COMMAND_INT_ONLY
    vehicle = node.vehicle
    where = place(node, c.x, c.y, c.z, c.frame)
    if where is None or (c.x == 0 and c.y == 0):
        return CommandResult.DENIED
    if not vehicle.takes_targets and not (math.isfinite(c.p2) and int(c.p2) & CHANGE_MODE):
        return unasked
    if not vehicle.fence.allows(where):
        return outside
    if not vehicle.takes_targets and not vehicle.set_mode(vehicle.guided.number):
        return CommandResult.FAILED
    return CommandResult.ACCEPTED if go(node, c, where) else CommandResult.FAILED


def _change_speed(node: ArduNode, c: Command) -> int:
    limit = {0: "speed", 1: "speed", 2: "speed_up", 3: "speed_down"}.get(int(c.p1))
    if c.p2 <= 0:
        return CommandResult.DENIED
    if limit is None or not node.vehicle.mode.changes_speed:
        return CommandResult.FAILED
    node.vehicle.change_speed(limit, c.p2)
    return CommandResult.ACCEPTED


def _run_prearm(node: ArduNode, c: Command) -> int:
    if node.vehicle.armed:
        return CommandResult.TEMPORARILY_REJECTED
    node.say_prearm()
    return CommandResult.ACCEPTED


def _reboot(node: ArduNode, c: Command) -> int:
    if c.p1 not in (1, 3):
        return CommandResult.UNSUPPORTED
    if node.vehicle.armed and round(c.y) != FORCE:
        return CommandResult.FAILED
    node.reboot_after_ack()
    return CommandResult.ACCEPTED


def _mission_start(node: ArduNode, c: Command) -> int:
    """AUTO, and off the ground with the throttle stick down too."""
    if c.p1 or c.p2:
        return CommandResult.DENIED
    vehicle = node.vehicle
    if not vehicle.set_mode(_AUTO):
        return CommandResult.FAILED
    vehicle.auto_armed = vehicle.armed
    if vehicle.mission.state is not State.RUNNING:
        vehicle.mission.start_or_resume()
    return CommandResult.ACCEPTED


def _set_current(node: ArduNode, c: Command) -> int:
    """DO_SET_MISSION_CURRENT; ``p2`` 1: with the jumps' counters back at zero, and running again."""
    mission, seq = node.vehicle.mission, int(c.p1)
    if not 0 <= seq < len(mission):
        return CommandResult.DENIED
    again = c.p2 == 1
    if again:
        mission.reset()
    if not mission.set_current(seq):
        return CommandResult.FAILED
    if again:
        mission.resume()
    return send_message(node, c, "MISSION_CURRENT")


def _trigger_distance(node: ArduNode, c: Command) -> int:
    node.vehicle.camera.trigger_every(c.p1, at_once=c.p3 == 1)
    return CommandResult.ACCEPTED


HANDLERS: Handlers = {
    **SHARED_HANDLERS,
    176: _set_mode,
    178: _change_speed,
    179: _set_home,
    183: lambda node, c: node.vehicle.set_servo(int(c.p1), min(max(int(c.p2), 0), 65535)),
    185: lambda node, c: c.p1 > 0.5 and node.vehicle.disarm(forced=True),
    192: reposition,
    206: _trigger_distance,
    224: _set_current,
    246: _reboot,
    300: _mission_start,
    401: _run_prearm,
    410: _get_home,
    520: _request_version,
    42428: lambda node, c: node.banner(c.channel) or CommandResult.ACCEPTED,
}
