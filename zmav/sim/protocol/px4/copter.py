"""What a PX4 multicopter reports, and which commands it takes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from zmav.sim.protocol.base import Handler, Report
from zmav.sim.protocol.px4.commands import HANDLERS
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.protocol.px4.telemetry import REPORTS


class Px4CopterNode(Px4Node):
    """Speaks for one :class:`~zmav.sim.autopilots.px4.copter.Px4Copter`."""

    HANDLERS: ClassVar[Mapping[int, Handler]] = HANDLERS
    REPORTS: ClassVar[Mapping[str, Report]] = REPORTS
