"""ArduPilot: what it says and takes; what one kind of vehicle does differently stands before it, as data.

Modes and numbers are those of the firmware's ``mode.h`` files, the levels those of its ``GCS_MAVLink_*.cpp``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from zmav.autopilots import base, convert
from zmav.autopilots.base import Autopilot, Command, Convert, Latest, Level, Message, MissionRules, Need, Target

_OWN_GCS = Need(
    ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    lambda value, sysid: sysid,
    True,
    "ArduPilot takes sticks and RC overrides only from its ground station's system id, and we speak with the vehicle's",
)
"""We do not speak with the ground station's id instead: every override would then hide that it is lost"""
HAS_FILES = 0x20
"""MAV_PROTOCOL_CAPABILITY_FTP; whether plans are among the files, only asking for one tells"""
PLAN_FILES = frozenset({"mission", "rally"})
"""The file server has a thread of its own. It locks the mission while it reads an item, and rally points lie in storage
alone; but the index of a fence it reads, or makes, without a lock, while the main loop may be making it anew
(AC_PolyFence_loader): after each upload of a fence, that is when it would be read back. While it is armed no file is
asked for: for 1 s after each answer of that server every stream comes at a quarter of its rate (GCS_Common.cpp).
"""
OVERRIDES: Mapping[Level, tuple[Need, ...]] = {"manual": (_OWN_GCS,), "rc": (_OWN_GCS,)}
THRUST_AS_THRUST = Need(
    ("GUID_OPTIONS",),
    lambda value, sysid: value | 8,
    False,
    "ArduCopter takes the thrust of an attitude for a climb rate (0.5 keeps the height, 1 climbs at WPNAV_SPEED_UP)",
)
_EVERYWHERE: Mapping[Level, Convert | str] = {
    "rc": convert.rc_override_16,
    "servo": convert.servos,
    "torque": "ArduPilot takes no torques over MAVLink: send rates and a thrust",
}


@dataclass(frozen=True)
class Rules:
    """What one kind of vehicle does differently; a None is something that it cannot do."""

    modes: str
    hold: str
    land: str | None
    takeoff_mode: str | None
    takeoff_command: bool
    loiter: str
    levels: Mapping[Level, Convert | str]
    needs: Mapping[Level, tuple[Need, ...]] = field(default_factory=lambda: OVERRIDES)
    circles: bool = False
    """it is given points to circle about by command, and takes no stream of them"""
    keepalive_hz: float = 4.0
    unarmable: str = ""
    """modes in which it refuses to be armed, or sets off by itself as soon as it is"""


COPTER = Rules(
    modes="STABILIZE:0 ACRO:1 ALT_HOLD:2 AUTO:3 GUIDED:4 LOITER:5 RTL:6 CIRCLE:7 LAND:9 DRIFT:11 SPORT:13 FLIP:14 "
    "AUTOTUNE:15 POSHOLD:16 BRAKE:17 THROW:18 AVOID_ADSB:19 GUIDED_NOGPS:20 SMART_RTL:21 FLOWHOLD:22 FOLLOW:23 "
    "ZIGZAG:24 SYSTEMID:25 AUTOROTATE:26 AUTO_RTL:27 TURTLE:28",
    hold="GUIDED",
    land="LAND",
    takeoff_mode="GUIDED",
    takeoff_command=True,
    unarmable="AUTO LAND RTL SMART_RTL BRAKE CIRCLE AUTOTUNE FLIP AVOID_ADSB FOLLOW SYSTEMID AUTO_RTL",
    loiter="BRAKE",  # LOITER obeys a throttle stick that nobody holds, and comes down
    levels={
        "position": convert.motion,
        "trajectory": convert.position_and_velocity,
        "velocity": convert.motion,
        "acceleration": convert.motion,
        "attitude": convert.attitude_and_rates,
        "rates": convert.rates,
        "manual": convert.sticks,
        **_EVERYWHERE,
    },
    needs={**OVERRIDES, "attitude": (THRUST_AS_THRUST,), "rates": (THRUST_AS_THRUST,)},
)
ROVER = Rules(
    modes="MANUAL:0 ACRO:1 STEERING:3 HOLD:4 LOITER:5 FOLLOW:6 SIMPLE:7 DOCK:8 CIRCLE:9 AUTO:10 RTL:11 SMART_RTL:12 "
    "GUIDED:15 INITIALISING:16",
    hold="HOLD",
    land=None,
    takeoff_mode=None,
    takeoff_command=False,
    unarmable="AUTO RTL SMART_RTL CIRCLE DOCK FOLLOW INITIALISING",
    loiter="LOITER",
    levels={
        "position": convert.position_only,
        "trajectory": convert.position_only,
        "velocity": convert.ground_velocity,
        "acceleration": "ArduRover takes no accelerations: send a velocity",
        "attitude": convert.attitude,
        "rates": convert.rates,
        "manual": convert.sticks_both_ways,
        **_EVERYWHERE,
    },
)
PLANE = Rules(
    modes="MANUAL:0 CIRCLE:1 STABILIZE:2 TRAINING:3 ACRO:4 FBWA:5 FBWB:6 CRUISE:7 AUTOTUNE:8 AUTO:10 RTL:11 LOITER:12 "
    "TAKEOFF:13 AVOID_ADSB:14 GUIDED:15 INITIALISING:16 QSTABILIZE:17 QHOVER:18 QLOITER:19 QLAND:20 QRTL:21 "
    "QAUTOTUNE:22 QACRO:23 THERMAL:24 LOITER_ALT_QLAND:25 AUTOLAND:26",
    hold="LOITER",
    land="AUTOLAND",
    takeoff_mode="TAKEOFF",
    takeoff_command=False,
    unarmable="AUTO TAKEOFF",
    loiter="LOITER",
    levels={
        "position": convert.circle_at,
        "trajectory": "ArduPlane flies no trajectories: send positions to circle about, or attitudes",
        "velocity": "ArduPlane takes no velocities: send positions to circle about, or attitudes",
        "acceleration": "ArduPlane takes no accelerations: send positions to circle about, or attitudes",
        "attitude": convert.attitude,
        "rates": "ArduPlane takes no body rates in GUIDED (it would fly level instead): send attitudes",
        "manual": convert.sticks,
        **_EVERYWHERE,
    },
    circles=True,
)
RULES: Mapping[str, Rules] = {
    "copter": COPTER,
    "heli": COPTER,
    "rover": ROVER,
    "boat": ROVER,
    "plane": PLANE,
    "vtol": PLANE,
}


EKF_POS_HORIZ_ABS = 16
EKF_CONST_POS_MODE = 128
PREARM_CHECK = 0x10000000
_OWN_PARAMS = (
    "MAV_SYSID SYSID_THISMAV STAT_* FORMAT_VERSION BARO*_GND_PRESS BARO_GND_TEMP BARO_FIELD_ELV *_DEVID "
    "INS_ACC*_ID INS_GYR*_ID INS*_ACC_ID INS*_GYR_ID COMPASS_DEV_ID*"
)
"""the system id, and what its parameter documentation marks @ReadOnly or @Volatile"""


class ArduPilot(Autopilot):
    name = "ardupilot"
    log_suffix = ".bin"
    logs_while_armed = False
    floor: ClassVar[Mapping[str, float]] = {
        "GLOBAL_POSITION_INT": 10.0,
        "ATTITUDE": 10.0,
        "SYS_STATUS": 2.0,
        "GPS_RAW_INT": 2.0,
        "BATTERY_STATUS": 0.5,
        "EKF_STATUS_REPORT": 2.0,
        "EXTENDED_SYS_STATE": 2.0,
        "MISSION_CURRENT": 1.0,
    }
    # AUTO, AUTO_RTL; ARMDISARM (old, new, with air mode), DISARM, ARM_EMERGENCY_STOP, by RC_Channel.h.
    switches: ClassVar[frozenset[int]] = frozenset({16, 99, 41, 153, 154, 81, 165})
    camera_params: ClassVar[tuple[str, ...]] = ("CAM1_TYPE", "CAM2_TYPE")
    own_params: ClassVar[tuple[str, ...]] = tuple(_OWN_PARAMS.split())

    def __init__(self, kind: str, *, files: frozenset[str] = frozenset()) -> None:
        super().__init__(kind)
        self.rules = RULES.get(kind, COPTER)
        self.keepalive_hz = self.rules.keepalive_hz
        self.circle_param = "WP_LOITER_RAD" if self.rules.circles else None
        self.levels, self.needs_by_level = self.rules.levels, self.rules.needs
        self.lands_after_rtl = self.rules.takeoff_command
        self.home_circle_param = "RTL_RADIUS" if self.rules.circles else None
        self.home_height_params = ("RTL_ALT_FINAL", "RTL_ALT_FINAL_M") if self.lands_after_rtl else ()
        self.missions = MissionRules(
            mode="AUTO",
            start_command=self.rules.takeoff_command,
            home_first=True,
            window=4,
            files=files,
            exact=False,
        )
        pairs = (pair.split(":") for pair in self.rules.modes.split())
        self._modes = {name: base.custom_mode(name, int(number)) for name, number in pairs}
        self._names = {mode.custom: name for name, mode in self._modes.items()}
        self._unarmable = frozenset(self.rules.unarmable.split())

    def told(self, capabilities: int) -> Autopilot:
        return ArduPilot(self.kind, files=PLAN_FILES if capabilities & HAS_FILES else frozenset())

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        return self._names.get(custom_mode, f"MODE_{custom_mode}")

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
            return self.rules.hold if mode in (*self._unarmable, self.guided) else None
        return self.guided if mode in self._unarmable else None

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
