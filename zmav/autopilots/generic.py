"""Any other MAVLink autopilot: what the common dialect promises, and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from zmav.autopilots import base, convert
from zmav.autopilots.base import Autopilot, Command, Convert, Latest, Level, Message, Mode, Target


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
    modes_by_level: Mapping[Level, str | None] = {"manual": None, "rc": None, "servo": None}

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        return f"MODE_{custom_mode}"

    def modes(self) -> dict[str, Mode]:
        return {}

    @property
    def guided(self) -> str:
        raise self.unsupported("a guided mode")

    def missing(self, latest: Latest, checks: Sequence[str] = ()) -> list[str]:
        return [] if latest("GLOBAL_POSITION_INT") is not None else ["no GLOBAL_POSITION_INT heard"]

    def takeoff(self, alt_rel: float, latest: Latest) -> tuple[str | None, Command | None]:
        return None, Command("MAV_CMD_NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, alt_rel))

    def hold(self) -> tuple[str, Message | None]:
        raise self.unsupported("hold")

    def land(self) -> str:
        raise self.unsupported("land by mode")

    def rtl(self) -> str:
        raise self.unsupported("a return to launch")

    def loiter(self) -> str:
        raise self.unsupported("loiter")

    def goto(self, target: Target) -> Command | Message:
        return base.reposition(target)
