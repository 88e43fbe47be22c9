"""A command as any autopilot hears it: https://mavlink.io/en/services/command.html."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from zmav.sim.protocol.channel import Channel
from zmav.sim.protocol.part import Sender

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)  # MAV_RESULT
COMMAND_INT_ONLY = 8
FORCE = 21196  # param2 of arming that skips the checks, and of disarming in flight
CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
CHANGE_MODE = 1  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
RELATIVE_ALT = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT, which a COMMAND_LONG is taken to mean
_NO_PLACE = 2**31 - 1  # x and y of a COMMAND_INT that names none


class Command(msgspec.Struct, frozen=True):
    """COMMAND_LONG or COMMAND_INT: ``x`` and ``y`` as they came; ``sender`` is who asked, on ``channel``."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    x: float
    y: float
    z: float
    frame: int
    as_int: bool
    channel: Channel
    sender: Sender

    @property
    def degrees(self) -> tuple[float, float]:
        """Latitude and longitude; NaN where not given."""
        if not self.as_int:
            return self.x, self.y
        return (math.nan, math.nan) if self.x == self.y == _NO_PLACE else (self.x * 1e-7, self.y * 1e-7)


def read_command(msg: dict[str, Any], channel: Channel, sender: Sender) -> Command:
    """The command of a message of either form."""
    as_int = "x" in msg
    x, y, z = (msg[name] for name in (("x", "y", "z") if as_int else ("param5", "param6", "param7")))
    p1, p2, p3, p4 = (msg[f"param{i}"] for i in range(1, 5))
    frame = msg.get("frame", RELATIVE_ALT)
    return Command(msg["command"], p1, p2, p3, p4, x, y, z, frame, as_int, channel, sender)
