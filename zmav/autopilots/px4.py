"""PX4: main mode in bits 16-23 of the custom mode, sub mode in bits 24-31 (its ``px4_custom_mode.h``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import msgspec

from zmav.autopilots import convert
from zmav.autopilots.base import (
    NAN,
    Autopilot,
    Command,
    Convert,
    Latest,
    Level,
    Message,
    MissionRules,
    Mode,
    Need,
    Target,
)

_MODES = (
    "MANUAL:1/0 ALTCTL:2/0 POSCTL:3/0 READY:4/1 TAKEOFF:4/2 HOLD:4/3 MISSION:4/4 RTL:4/5 LAND:4/6 FOLLOW:4/8 "
    "PRECLAND:4/9 ACRO:5/0 OFFBOARD:6/0 STABILIZED:7/0 RATTITUDE:8/0 TERMINATION:10/0"
)
PREARM_CHECK = 0x10000000
_NO_TORQUE = (
    "this PX4 takes no torques over MAVLink: 1.14 dropped SET_ACTUATOR_CONTROL_TARGET (its uORB topics "
    "vehicle_torque_setpoint and vehicle_thrust_setpoint are reached through uXRCE-DDS only), and 1.13 and older say "
    "in AUTOPILOT_VERSION that they take it: send rates and a thrust"
)
TAKES_TORQUE = 0x400
"""MAV_PROTOCOL_CAPABILITY_SET_ACTUATOR_TARGET, which newer definitions keep reserved"""
_NO_JOYSTICK = Need(
    ("COM_RC_IN_MODE",),
    lambda value, sysid: 2 if value in (0, 4) else value,
    True,
    "PX4 does not listen to MANUAL_CONTROL",
)
_NO_GROUND_STATION = Need(
    ("NAV_DLL_ACT",),
    lambda value, sysid: 0,
    False,
    "PX4 arms only while it hears a ground station, and a companion is none: start one, or",
)
STICKS_HEARD = 0.5
"""s of MANUAL_CONTROL after which it takes them for a pilot's"""
_EVERYWHERE: Mapping[Level, Convert | str] = {
    "torque": _NO_TORQUE,
    "manual": convert.sticks,
    "rc": convert.rc_whole,
    "servo": convert.actuators,
}
_MULTICOPTER: Mapping[Level, Convert | str] = {
    "position": convert.motion,
    "trajectory": convert.motion,
    "velocity": convert.motion,
    "acceleration": convert.motion,
    # Rates beside an attitude would be published as setpoints of their own.
    "attitude": convert.attitude,
    "rates": convert.rates,
    **_EVERYWHERE,
}
_FIXED_WING: Mapping[Level, Convert | str] = {
    "position": convert.position_only,
    "trajectory": convert.position_only,
    "velocity": "PX4's fixed wing follows no velocities: send positions",
    "acceleration": "PX4's fixed wing follows no accelerations: send positions",
    "attitude": convert.attitude,
    "rates": convert.rates,
    **_EVERYWHERE,
}
_ROVER: Mapping[Level, Convert | str] = {
    "position": convert.position_only,
    "trajectory": convert.position_only,
    "velocity": convert.motion,
    "acceleration": "PX4's rover follows no accelerations: send a velocity",
    "attitude": convert.attitude,
    "rates": convert.rates,
    **_EVERYWHERE,
}
_LEVELS: Mapping[str, Mapping[Level, Convert | str]] = {"plane": _FIXED_WING, "rover": _ROVER, "boat": _ROVER}


def _mode(name: str, main: int, sub: int) -> Mode:
    return Mode(name, main << 16 | sub << 24, Command("MAV_CMD_DO_SET_MODE", (1.0, float(main), float(sub))))


class Px4(Autopilot):
    name = "px4"
    log_suffix = ".ulg"
    command_frame: ClassVar[str] = "MAV_FRAME_GLOBAL"
    ignores_frames: ClassVar[bool] = True
    log_ids_are_places: ClassVar[bool] = True
    report_checks: ClassVar[Command | None] = Command("MAV_CMD_RUN_PREARM_CHECKS")
    # PX4 sends all others by itself on its onboard link. It grants this one, and no rate of the two below: a HEARTBEAT
    # comes once a second, and shows a mode up to a second late.
    mode_message = "CURRENT_MODE"
    floor: ClassVar[Mapping[str, float]] = {"CURRENT_MODE": 20.0}
    unrated: ClassVar[frozenset[str]] = frozenset({"HEARTBEAT", "MISSION_CURRENT"})
    never_rated: ClassVar[tuple[int, ...]] = (2, 3, 4)
    missions = MissionRules(
        mode="MISSION",
        start_command=False,
        set_by_command=False,
        mission_frame=True,
        exact=False,
        never_placed=frozenset({"MAV_CMD_DO_LAND_START", "MAV_CMD_DO_SET_HOME"}),
    )
    params_bytewise: ClassVar[bool] = True
    camera_params: ClassVar[tuple[str, ...]] = ("TRIG_MODE",)
    # The system id, flight time and number of flights, ids of the sensors it found.
    own_params: ClassVar[tuple[str, ...]] = ("MAV_SYS_ID", "LND_FLIGHT_T_*", "COM_FLIGHT_UUID", "CAL_*_ID")
    # Below 2 Hz it leaves OFFBOARD, and on the ground it enters it only where the stream has flown for a second.
    keepalive_hz = 20.0
    engage_after = 1.0
    modes_by_level: Mapping[Level, str | None] = {"manual": "POSCTL", "rc": None, "servo": None}
    needs_by_level: Mapping[Level, tuple[Need, ...]] = {"manual": (_NO_JOYSTICK,)}

    def __init__(self, kind: str, *, torque: bool = False) -> None:
        super().__init__(kind)
        self.levels = _LEVELS.get(kind, _MULTICOPTER)
        self.circle_param = "NAV_LOITER_RAD" if kind == "plane" else None
        if torque:
            self.levels = {**self.levels, "torque": convert.torques}
        for item in _MODES.split():
            name, numbers = item.split(":")
            main, sub = numbers.split("/")
            self._modes[name] = _mode(name, int(main), int(sub))
        self._names = {mode.custom: name for name, mode in self._modes.items()}

    def told(self, capabilities: int) -> Autopilot:
        return Px4(self.kind, torque=bool(capabilities & TAKES_TORQUE))

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        # Only AUTO (4) has sub modes that matter; POSCTL's (orbit, slow) are still POSCTL.
        exact = self._names.get(custom_mode & 0xFFFF0000)
        return exact or self._names.get(main << 16) or f"MODE_{main}/{sub}"

    @property
    def guided(self) -> str:
        return "OFFBOARD"

    def missing(self, latest: Latest, checks: Sequence[str] = ()) -> list[str]:
        """The pre-arm bit sums up PX4's health and arming checks; the reasons themselves come as events (``checks``).

        Only its ``health`` is ever set. A disarmed vehicle left in OFFBOARD without a stream fails it, too.
        """
        status, heartbeat = latest("SYS_STATUS"), latest("HEARTBEAT")
        if status is None:
            return ["SYS_STATUS not heard"]
        if status["onboard_control_sensors_health"] & PREARM_CHECK:
            return []
        mode = self.mode_name(heartbeat["base_mode"], heartbeat["custom_mode"]) if heartbeat else ""
        blocks = {"OFFBOARD": "without a stream", "MISSION": "without a valid mission"}.get(mode)
        *others, last = checks or ("pre-arm checks fail",)
        return [*others, last + (f" (in {mode} {blocks}: enter another mode, such as HOLD)" if blocks else "")]

    def takeoff(self, alt_rel: float, latest: Latest) -> tuple[str | None, Command | None]:
        """NAV_TAKEOFF with an altitude above mean sea level, which is what PX4 takes; it changes the mode by itself."""
        home_amsl = self._home_amsl(latest, "takeoff")
        return None, Command("MAV_CMD_NAV_TAKEOFF", (NAN, 0, 0, NAN, NAN, NAN, home_amsl + alt_rel))

    # NAV_MC_ALT_RAD (0.8 m): HOLD then keeps the height that it found, up to so much below the one told.
    takeoff_ends = ("HOLD", 1.0)

    def climb_on(self, alt_rel: float, latest: Latest) -> Command:
        amsl = self._home_amsl(latest, "a climb") + alt_rel
        return Command("MAV_CMD_DO_REPOSITION", (-1.0, 1.0, 0.0, NAN, NAN, NAN, amsl))

    def placed(self, target: Target, latest: Latest) -> Target:
        """PX4 does not look at the frame of a COMMAND_INT: 10 m above home would be taken for 10 m above the sea, and
        it would fly into the ground (PX4-Autopilot issues 10246 and 28257).
        """
        if target.alt_rel is None:
            return target
        amsl = self._home_amsl(latest, "an altitude above home") + target.alt_rel
        return msgspec.structs.replace(target, alt_rel=None, alt_amsl=amsl)

    def _home_amsl(self, latest: Latest, what: str) -> float:
        position = latest("GLOBAL_POSITION_INT")
        if position is None:
            raise self.unsupported(f"{what} without a global position")
        return float(position["alt"] - position["relative_alt"]) / 1000.0

    pause: ClassVar[Command | None] = Command("MAV_CMD_DO_REPOSITION", (-1.0, 1.0, 0.0, NAN, NAN, NAN, NAN))

    def hold(self) -> tuple[str, Message | None]:
        return "HOLD", None

    def land(self) -> str:
        return "LAND"

    def rtl(self) -> str:
        return "RTL"

    def arming_mode(self, mode: str | None) -> str | None:
        """OFFBOARD is accepted while disarmed, and arming then refused until the mode changes. In MISSION and TAKEOFF
        it takes off as soon as it is armed: a mission flown to its end leaves the mode at MISSION.
        """
        unnamed = mode is not None and mode.startswith("MODE_4/")  # of its own doing: a VTOL's takeoff is one
        return "HOLD" if unnamed or mode in ("OFFBOARD", "LAND", "RTL", "PRECLAND", "MISSION", "TAKEOFF") else None

    arming_needs = (_NO_GROUND_STATION,)

    # COM_OBL_RC_ACT 5, and 0 to 2: the sticks, which nobody may hold.
    stream_lost: ClassVar[tuple[str, ...]] = ("HOLD", "POSCTL", "ALTCTL", "STABILIZED")
    failsafe_waits: ClassVar[tuple[str, float]] = ("COM_FAIL_ACT_T", 5.0)

    def engages_after(self, level: Level, flies: bool) -> float:
        """In flight it enters OFFBOARD as soon as there is a setpoint, and POSCTL once it has heard the sticks."""
        if level == "manual":
            return STICKS_HEARD
        return 0.0 if flies else self.engage_after

    def servo(self, output: int, pwm: int) -> Command:
        """MAV_CMD_DO_SET_ACTUATOR takes -1 to 1 for the outputs assigned to "Offboard Actuator Set" 1 to 6."""
        return convert.actuator_command((*(None,) * (output - 1), pwm))

    def loiter(self) -> str:
        return "HOLD"
