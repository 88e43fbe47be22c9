"""Types and unit conversions that the reports share."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from zmav.sim.fleet import Sense

if TYPE_CHECKING:
    from zmav.sim.protocol.node import MavNode

Fields = dict[str, Any]
Report = Callable[["MavNode"], "Fields | None"]


def e7(degrees: float) -> int:
    """Degrees as MAVLink's degE7."""
    return round(degrees * 1e7)


def boot_ms(node: MavNode) -> int:
    return int(node.copter.uptime * 1000.0)


def boot_us(node: MavNode) -> int:
    return int(node.copter.uptime * 1e6)


def centidegrees(yaw: float) -> int:
    """An angle in radians as 0 to 35999."""
    return round(math.degrees(yaw) * 100.0) % 36000


def int16(value: float) -> int:
    """Rounded, and held at the ends of its field."""
    return min(max(round(value), -32768), 32767)


def euler(s: Sense, time_boot_ms: int) -> Fields:
    """ATTITUDE."""
    rates = {"rollspeed": s.p, "pitchspeed": s.q, "yawspeed": s.r}
    return {"time_boot_ms": time_boot_ms, "roll": s.roll, "pitch": s.pitch, "yaw": s.yaw, **rates}


def quaternion(s: Sense, time_boot_ms: int) -> Fields:
    """ATTITUDE_QUATERNION."""
    rates = {"rollspeed": s.p, "pitchspeed": s.q, "yawspeed": s.r}
    return {"time_boot_ms": time_boot_ms, "q1": s.qw, "q2": s.qx, "q3": s.qy, "q4": s.qz, **rates}
