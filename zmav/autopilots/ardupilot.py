"""ArduPilot: what it says and takes; what differs by kind of vehicle is in :mod:`zmav.autopilots.ardupilot_kinds`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from zmav.autopilots import base, convert
from zmav.autopilots.ardupilot_kinds import COPTER, MODES_BY_LEVEL, RULES
from zmav.autopilots.base import Autopilot, Command, Latest, Message, MissionRules, Mode, Target

EKF_POS_HORIZ_ABS = 16
EKF_CONST_POS_MODE = 128
PREARM_CHECK = 0x10000000


class ArduPilot(Autopilot):
    name = "ardupilot"
    log_suffix = ".bin"
    logs_while_armed = False
    floor: ClassVar[Mapping[str, float]] = {
        "GLOBAL_POSITION_INT": 10.0,
        "ATTITUDE": 10.0,
        "SYS_STATUS": 2.0,
        "GPS_RAW_INT": 2.0,
        "EKF_STATUS_REPORT": 2.0,
        "EXTENDED_SYS_STATE": 2.0,
        "MISSION_CURRENT": 1.0,
    }
    camera_params: ClassVar[tuple[str, ...]] = ("CAM1_TYPE", "CAM2_TYPE")
    # The system id, and what its parameter documentation marks @ReadOnly or @Volatile.
    own_params: ClassVar[tuple[str, ...]] = (
        "MAV_SYSID",
        "SYSID_THISMAV",
        "STAT_*",
        "FORMAT_VERSION",
        "BARO*_GND_PRESS",
        "BARO_GND_TEMP",
        "BARO_FIELD_ELV",
        "*_DEVID",
        "INS_ACC*_ID",
        "INS_GYR*_ID",
        "INS*_ACC_ID",
        "INS*_GYR_ID",
        "COMPASS_DEV_ID*",
    )

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.rules = RULES.get(kind, COPTER)
        self.keepalive_hz = self.rules.keepalive_hz
        self.circle_param = "WP_LOITER_RAD" if self.rules.circles else None
        self.levels, self.modes_by_level = self.rules.levels, MODES_BY_LEVEL
        self.needs_by_level = self.rules.needs
        self.lands_after_rtl = self.rules.takeoff_command
        self.home_circle_param = "RTL_RADIUS" if self.rules.circles else None
        self.home_height_params = ("RTL_ALT_FINAL", "RTL_ALT_FINAL_M") if self.lands_after_rtl else ()
        self.missions = MissionRules(
            mode="AUTO", start_command=self.rules.takeoff_command, home_first=True, window=4, exact=False
        )
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

    def missing(self, latest: Latest, checks: Sequence[str] = ()) -> list[str]:
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
        return self.rules.hold, convert.stop() if self.rules.hold == self.guided else None

    def land(self) -> str:
        if self.rules.land is None:
            raise self.unsupported("land")
        return self.rules.land

    def arming_mode(self, mode: str | None) -> str | None:
        """A rover that is armed in GUIDED drives on to the target it had there before: one armed in HOLD stands."""
        if self.on_surface:
            return self.rules.hold if mode in (*self.rules.unarmable, self.guided) else None
        return self.guided if mode in self.rules.unarmable else None

    def rtl(self) -> str:
        return "RTL"

    def loiter(self) -> str:
        return self.rules.loiter

    def goto(self, target: Target) -> Command | Message:
        return base.reposition(target) if self.rules.circles else convert.position_target(target)

    def release(self, target: Target) -> list[Message]:
        """An override lasts RC_OVERRIDE_TIME (3 s) beyond the last message, unless it is given back."""
        if target.rc is not None:
            return [convert.released_rc()]
        return [convert.released_sticks()] if target.manual is not None else []
