"""ArduPilot: copter, rover, plane. Modes and numbers are those of its firmware's ``mode.h`` files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from zmav.autopilots import base
from zmav.autopilots.base import Autopilot, Command, Latest, Message, Mode, Target

EKF_POS_HORIZ_ABS = 16
EKF_CONST_POS_MODE = 128
PREARM_CHECK = 0x10000000


@dataclass(frozen=True)
class Rules:
    """What one kind of vehicle does differently; a None is something that it cannot do."""

    modes: str
    hold: str
    land: str | None
    takeoff_mode: str | None
    takeoff_command: bool
    streams: bool
    """takes position and velocity setpoints (a plane is given points to loiter about instead)"""


_COPTER = Rules(
    modes="STABILIZE:0 ACRO:1 ALT_HOLD:2 AUTO:3 GUIDED:4 LOITER:5 RTL:6 CIRCLE:7 LAND:9 DRIFT:11 SPORT:13 FLIP:14 "
    "AUTOTUNE:15 POSHOLD:16 BRAKE:17 THROW:18 AVOID_ADSB:19 GUIDED_NOGPS:20 SMART_RTL:21 FLOWHOLD:22 FOLLOW:23 "
    "ZIGZAG:24 SYSTEMID:25 AUTOROTATE:26 AUTO_RTL:27 TURTLE:28",
    hold="GUIDED",
    land="LAND",
    takeoff_mode="GUIDED",
    takeoff_command=True,
    streams=True,
)
_ROVER = Rules(
    modes="MANUAL:0 ACRO:1 STEERING:3 HOLD:4 LOITER:5 FOLLOW:6 SIMPLE:7 DOCK:8 CIRCLE:9 AUTO:10 RTL:11 SMART_RTL:12 "
    "GUIDED:15 INITIALISING:16",
    hold="HOLD",
    land=None,
    takeoff_mode=None,
    takeoff_command=False,
    streams=True,
)
_PLANE = Rules(
    modes="MANUAL:0 CIRCLE:1 STABILIZE:2 TRAINING:3 ACRO:4 FBWA:5 FBWB:6 CRUISE:7 AUTOTUNE:8 AUTO:10 RTL:11 LOITER:12 "
    "TAKEOFF:13 AVOID_ADSB:14 GUIDED:15 INITIALISING:16 QSTABILIZE:17 QHOVER:18 QLOITER:19 QLAND:20 QRTL:21 "
    "QAUTOTUNE:22 QACRO:23 THERMAL:24 LOITER_ALT_QLAND:25 AUTOLAND:26",
    hold="LOITER",
    land="AUTOLAND",
    takeoff_mode="TAKEOFF",
    takeoff_command=False,
    streams=False,
)
_SUB = Rules(
    modes="STABILIZE:0 ACRO:1 ALT_HOLD:2 AUTO:3 GUIDED:4 CIRCLE:7 SURFACE:9 POSHOLD:16 MANUAL:19",
    hold="POSHOLD",
    land="SURFACE",
    takeoff_mode=None,
    takeoff_command=False,
    streams=True,
)
RULES: Mapping[str, Rules] = {
    "copter": _COPTER,
    "heli": _COPTER,
    "rover": _ROVER,
    "boat": _ROVER,
    "plane": _PLANE,
    "vtol": _PLANE,
    "sub": _SUB,
}


class ArduPilot(Autopilot):
    name = "ardupilot"
    floor: ClassVar[Mapping[str, float]] = {
        "GLOBAL_POSITION_INT": 10.0,
        "ATTITUDE": 10.0,
        "SYS_STATUS": 2.0,
        "GPS_RAW_INT": 2.0,
        "EKF_STATUS_REPORT": 2.0,
        "EXTENDED_SYS_STATE": 2.0,
    }

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.rules = RULES.get(kind, _COPTER)
        self.lands_after_rtl = self.rules.takeoff_command
        pairs = (pair.split(":") for pair in self.rules.modes.split())
        self._modes = {name: base.custom_mode(name, int(number)) for name, number in pairs}
        self._names = {mode.custom: name for name, mode in self._modes.items()}

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        return self._names.get(custom_mode, f"MODE_{custom_mode}")

    def modes(self) -> dict[str, Mode]:
        return self._modes

    @property
    def guided(self) -> str:
        return "GUIDED"

    def missing(self, latest: Latest) -> list[str]:
        """The pre-arm bit rises too early for GUIDED: the EKF must also have an absolute horizontal position."""
        missing = []
        ekf, status = latest("EKF_STATUS_REPORT"), latest("SYS_STATUS")
        if ekf is None or not ekf["flags"] & EKF_POS_HORIZ_ABS or ekf["flags"] & EKF_CONST_POS_MODE:
            missing.append("EKF has no position estimate")
        if status is None:
            missing.append("SYS_STATUS not heard")
        elif not status["onboard_control_sensors_health"] & PREARM_CHECK:
            missing.append("pre-arm checks fail")
        return missing

    def has_position(self, latest: Latest) -> bool:
        """Before its origin is set, the EKF reports a place near 0, 0."""
        ekf = latest("EKF_STATUS_REPORT")
        return super().has_position(latest) and (ekf is None or bool(ekf["flags"] & EKF_POS_HORIZ_ABS))

    def takeoff(self, alt_rel: float, latest: Latest) -> tuple[str | None, Command | None]:
        if self.rules.takeoff_mode is None:
            raise self.unsupported("takeoff")
        command = Command("MAV_CMD_NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, alt_rel))
        return self.rules.takeoff_mode, command if self.rules.takeoff_command else None

    def hold(self) -> tuple[str, Message | None]:
        return self.rules.hold, base.stop() if self.rules.hold == self.guided else None

    def land(self) -> str:
        if self.rules.land is None:
            raise self.unsupported("land")
        return self.rules.land

    def rtl(self) -> str:
        return "RTL" if "RTL" in self._modes else "SURFACE"

    def goto(self, target: Target) -> Command | Message:
        return base.position_target(target) if self.rules.streams else base.reposition(target)

    def setpoint(self, target: Target) -> Message:
        if not self.rules.streams:
            raise self.unsupported("a setpoint stream")
        return base.position_target(target)
