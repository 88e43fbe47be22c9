"""Any other MAVLink autopilot: what the common dialect promises, and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from zmav.autopilots import convert
from zmav.autopilots.base import Autopilot, Convert, Latest, Level


class Generic(Autopilot):
    name = "generic"
    floor: ClassVar[Mapping[str, float]] = {"GLOBAL_POSITION_INT": 5.0, "ATTITUDE": 5.0, "SYS_STATUS": 1.0}

    levels: Mapping[Level, Convert | str] = {
        "position": convert.motion,
        "trajectory": convert.motion,
        "velocity": convert.motion,
        "acceleration": convert.motion,
        "attitude": convert.attitude,
        "rates": convert.rates,
        "manual": convert.sticks,
        "rc": convert.rc_override,
        "servo": convert.servos,
        "torque": "the common dialect has no message for torques",
    }

    def missing(self, latest: Latest, checks: Sequence[str] = ()) -> list[str]:
        return [] if latest("GLOBAL_POSITION_INT") is not None else ["no GLOBAL_POSITION_INT heard"]
