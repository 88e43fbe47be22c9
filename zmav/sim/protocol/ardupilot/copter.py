"""The MAVLink face of an ArduCopter: the commands that only a copter knows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.protocol.ardupilot import commands
from zmav.sim.protocol.ardupilot.commands import Handlers, enter
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.reports import REPORTS
from zmav.sim.protocol.base import Report
from zmav.sim.protocol.channel import RELATIVE_ALT, Command

_LOITER, _RTL, _LAND = 5, 6, 9


def _takeoff(node: MavNode[ArduCopter], c: Command) -> int:
    if c.frame != RELATIVE_ALT:
        return CommandResult.DENIED
    return math.isfinite(c.z) and node.vehicle.take_off(c.z)


HANDLERS: Handlers = {
    **commands.HANDLERS,
    17: enter(_LOITER),  # NAV_LOITER_UNLIM
    20: enter(_RTL),  # NAV_RETURN_TO_LAUNCH
    21: enter(_LAND),  # NAV_LAND
    22: _takeoff,
}


class CopterNode(MavNode[ArduCopter]):
    """Speaks for one :class:`ArduCopter`."""

    HANDLERS: ClassVar[Handlers] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
