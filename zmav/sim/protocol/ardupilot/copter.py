"""The MAVLink face of an ArduCopter: the commands that only a copter knows."""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.protocol.ardupilot.commands import (
    ACCEPTED,
    DENIED,
    FAILED,
    RELATIVE_ALT,
    Command,
    Handlers,
    enter,
    verdict,
)
from zmav.sim.protocol.ardupilot.node import MavNode

_LOITER, _RTL, _LAND = 5, 6, 9


def _copter(node: MavNode) -> ArduCopter:
    assert isinstance(node.vehicle, ArduCopter)
    return node.vehicle


def _takeoff(node: MavNode, c: Command) -> int:
    if c.frame != RELATIVE_ALT:
        return DENIED
    return verdict(math.isfinite(c.z) and _copter(node).take_off(c.z))


def _condition_yaw(node: MavNode, c: Command) -> int:
    copter = _copter(node)
    if not 0 <= c.p1 <= 360 or c.p4 not in (0, 1):
        return FAILED
    if not copter.mode.by_pilot:
        start, angle, rate = copter.sense.yaw, math.radians(c.p1), math.radians(c.p2)
        copter.heading.sweep(start, angle, rate, c.p3, relative=c.p4 == 1)
    return ACCEPTED


def _motor_test(node: MavNode, c: Command) -> int:
    if not all(math.isfinite(p) for p in (c.p3, c.p4, c.x)):
        return DENIED
    return verdict(_copter(node).motor_test.start(int(c.p1), int(c.p2), c.p3, c.p4, int(c.x)))


COMMANDS: Handlers = {
    17: enter(_LOITER),  # NAV_LOITER_UNLIM
    20: enter(_RTL),  # NAV_RETURN_TO_LAUNCH
    21: enter(_LAND),  # NAV_LAND
    22: _takeoff,
    84: _takeoff,  # NAV_VTOL_TAKEOFF
    85: enter(_LAND),  # NAV_VTOL_LAND
    115: _condition_yaw,
    209: _motor_test,  # DO_MOTOR_TEST
}


class CopterNode(MavNode):
    """Speaks for one :class:`ArduCopter`."""

    HANDLERS: ClassVar[Handlers] = {**MavNode.HANDLERS, **COMMANDS}
