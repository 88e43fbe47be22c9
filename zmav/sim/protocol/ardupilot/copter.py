"""The MAVLink face of an ArduCopter: the commands that only a copter knows."""

from __future__ import annotations

import math
from typing import ClassVar

from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.protocol.ardupilot.commands import Handlers, enter, verdict
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.command import DENIED, RELATIVE_ALT, Command

_LOITER, _RTL, _LAND = 5, 6, 9


def _copter(node: MavNode) -> ArduCopter:
    assert isinstance(node.vehicle, ArduCopter)
    return node.vehicle


def _takeoff(node: MavNode, c: Command) -> int:
    if c.frame != RELATIVE_ALT:
        return DENIED
    return verdict(math.isfinite(c.z) and _copter(node).take_off(c.z))


COMMANDS: Handlers = {
    17: enter(_LOITER),  # NAV_LOITER_UNLIM
    20: enter(_RTL),  # NAV_RETURN_TO_LAUNCH
    21: enter(_LAND),  # NAV_LAND
    22: _takeoff,
}


class CopterNode(MavNode):
    """Speaks for one :class:`ArduCopter`."""

    HANDLERS: ClassVar[Handlers] = {**MavNode.HANDLERS, **COMMANDS}
