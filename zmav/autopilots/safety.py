"""What an autopilot does when nobody speaks to it any more, as data: which parameters make that safe, and which modes
end by themselves.

``zmav doctor`` compares :data:`SAFETY` with the vehicle's parameters; docs/failsafes.md says what was measured.

Sources:
https://ardupilot.org/copter/docs/gcs-failsafe.html, https://ardupilot.org/copter/docs/radio-failsafe.html,
https://ardupilot.org/rover/docs/rover-failsafes.html, https://ardupilot.org/plane/docs/apms-failsafe-function.html,
https://docs.px4.io/v1.16/en/config/safety.html, https://docs.px4.io/v1.16/en/flight_modes/offboard.html
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from zmav.autopilots.base import Autopilot, commands, mode_of
from zmav.mavlink import Dialect, Frame, decode


@dataclass(frozen=True)
class Safety:
    """One parameter: ``bad(value, sysid)`` says whether it is unsafe, ``why`` what then happens, ``advice`` what to
    set. ``sysid`` is the vehicle's own system id. ``names``: the newest firmware's name first.
    """

    names: tuple[str, ...]
    bad: Callable[[float, int], bool]
    why: str
    advice: str
    essential: bool = True
    """without it a dead companion leaves the vehicle flying; otherwise it is a recommendation"""


def _is(*values: float) -> Callable[[float, int], bool]:
    return lambda value, sysid: value in values


def _above(most: float) -> Callable[[float, int], bool]:
    return lambda value, sysid: value > most


def _has_bit(bit: int) -> Callable[[float, int], bool]:
    return lambda value, sysid: bool(int(value) & bit)


_WATCH = Safety(
    ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    lambda value, sysid: int(value) != sysid,
    "the ground-station failsafe counts only heartbeats of this system: with a ground station's id (255) it does not "
    "see the companion die, and never starts where no ground station was heard",
    "the vehicle's own system id, which the companion speaks with, to be guarded against the companion's death; keep "
    "255 where a ground station always listens and its loss is what should count",
    essential=False,
)
_COPTER = (
    Safety(
        ("FS_GCS_ENABLE",),
        _is(0),
        "nothing happens when the heartbeats of MAV_GCS_SYSID stop: a copter with a dead companion hovers until the "
        "battery failsafe",
        "1 (RTL) or 5 (land)",
    ),
    Safety(
        ("FS_GCS_TIMEOUT",),
        _above(10.0),
        "the ground-station failsafe waits longer than 10 s",
        "5 (s)",
        essential=False,
    ),
    _WATCH,
    Safety(
        ("FS_OPTIONS",),
        _has_bit(2),
        "bit 1 (continue in AUTO on a ground-station failsafe): a mission goes on when its commander is gone",
        "16 (continue in pilot-controlled modes only)",
        essential=False,
    ),
    Safety(
        ("GUID_TIMEOUT",),
        _above(3.0),
        "velocities, accelerations and attitudes are flown on for longer than 3 s after the last one",
        "3 (s) or less; more than 1",
    ),
    Safety(
        ("FS_THR_ENABLE",),
        _is(0),
        "nothing happens when the pilot's radio is lost",
        "1 (RTL) or 3 (land), unless the copter is flown without a radio",
        essential=False,
    ),
    Safety(
        ("RTL_ALT_M",),
        lambda value, sysid: 0.0 < value < 5.0,
        "a return to launch flies back lower than 5 m",
        "15 (m), or the height of the highest obstacle and more",
        essential=False,
    ),
    Safety(
        ("RTL_ALT",),
        lambda value, sysid: 0.0 < value < 500.0,
        "a return to launch flies back lower than 5 m",
        "1500 (cm), or the height of the highest obstacle and more",
        essential=False,
    ),
)
_ROVER = (
    Safety(
        ("FS_GCS_ENABLE",),
        _is(0),
        "nothing happens when the heartbeats of MAV_GCS_SYSID stop",
        "1, with FS_ACTION 2 (hold)",
    ),
    Safety(("FS_ACTION",), _is(0), "a failsafe does nothing", "2 (hold) or 1 (RTL)"),
    _WATCH,
)
_PLANE = (
    Safety(
        ("FS_GCS_ENABL",),
        _is(0),
        "nothing happens when the heartbeats of MAV_GCS_SYSID stop: a plane in GUIDED circles its last point until the "
        "battery is empty",
        "1",
    ),
    Safety(("FS_LONG_ACTN",), _is(0), "the long failsafe goes on with the mission, and with GUIDED", "1 (RTL)"),
    _WATCH,
)
_PX4 = (
    Safety(
        ("COM_OF_LOSS_T",),
        _above(1.0),
        "an OFFBOARD stream may be silent for longer than 1 s before PX4 acts",
        "1.0 (s) or less",
    ),
    Safety(
        ("COM_OBL_RC_ACT",),
        lambda value, sysid: value in (0.0, 1.0, 2.0, 6.0, 7.0),
        "when the OFFBOARD stream is lost, the vehicle is left to the sticks (0 position, 1 altitude, 2 stabilized), "
        "stopped in the air (6) or disarmed (7); there may be nobody at the sticks",
        "5 (hold), 3 (return) or 4 (land)",
    ),
    Safety(
        ("COM_RCL_EXCEPT",),
        lambda value, sysid: not int(value) & 4,
        "bit 2 is not set: without a radio PX4 leaves OFFBOARD by its failsafe",
        "4, for a vehicle that flies OFFBOARD without a radio; leave it at 0 where a pilot must hold one",
        essential=False,
    ),
    Safety(
        ("NAV_DLL_ACT",),
        _is(0),
        "nothing happens when the data link to the ground is lost: a DO_REPOSITION or a mission is flown to its end",
        "2 (return) or 1 (hold), where a ground station always listens: PX4 then arms only while it hears one, and a "
        "companion is none",
        essential=False,
    ),
    Safety(
        ("COM_DL_LOSS_T",),
        _above(15.0),
        "the loss of the data link is noticed after more than 15 s",
        "10 (s)",
        essential=False,
    ),
)
SAFETY: dict[tuple[str, str], tuple[Safety, ...]] = {
    **{("ardupilot", kind): _COPTER for kind in ("copter", "heli")},
    **{("ardupilot", kind): _ROVER for kind in ("rover", "boat")},
    **{("ardupilot", kind): _PLANE for kind in ("plane", "vtol")},
    **{("px4", kind): _PX4 for kind in ("copter", "vtol", "rover", "plane")},
}
"""by the autopilot's name and the vehicle's kind"""

_ENDS_IN: dict[str, dict[str, tuple[str, ...]]] = {"px4": {"TAKEOFF": ("HOLD",), "MISSION": ("HOLD",)}}


def ends_in(autopilot: Autopilot, mode: str | None) -> tuple[str, ...]:
    """The modes that ``mode`` gives way to by itself when it has done its work: that is nobody's taking over."""
    return _ENDS_IN.get(autopilot.name, {}).get(mode or "", ())


def flies_on(autopilot: Autopilot) -> bool:
    """A position target is flown to however long nothing more is heard: it must never be far away.

    A plane is given a point to circle, and PX4 leaves OFFBOARD by itself.
    """
    return autopilot.name == "ardupilot" and autopilot.kind in ("copter", "heli", "rover", "boat")


_ANY: dict[str, tuple[str, ...]] = {
    "px4": ("TAKEOFF", "HOLD", "MISSION", "RTL", "LAND"),
    "ardupilot": ("GUIDED", "AUTO", "RTL", "LAND", "LOITER", "TAKEOFF", "HOLD", "QLAND", "QRTL", "BRAKE"),
}
_BY_VERB: dict[str, dict[str, tuple[str, ...]]] = {
    "px4": {"takeoff": ("TAKEOFF", "HOLD"), "goto": ("HOLD",), "mission_start": ("MISSION",)},
    "ardupilot": {"goto": ("GUIDED",), "mission_start": ("AUTO",)},
}


_CHANGING = commands(
    "DO_SET_MODE DO_SET_STANDARD_MODE NAV_TAKEOFF NAV_VTOL_TAKEOFF NAV_LAND NAV_VTOL_LAND NAV_RETURN_TO_LAUNCH "
    "NAV_LOITER_UNLIM NAV_PRECLAND MISSION_START DO_REPOSITION DO_PAUSE_CONTINUE DO_GO_AROUND DO_LAND_START "
    "DO_RETURN_PATH_START DO_CHANGE_ALTITUDE DO_ORBIT DO_FOLLOW"
)
"""commands that change the mode by themselves: after any other, a new mode is somebody else's wish"""


def changes_mode(command: str) -> bool:
    """A MAV_CMD that changes the mode by itself."""
    return command in _CHANGING


_SAFE = commands("NAV_LAND NAV_RETURN_TO_LAUNCH NAV_LOITER_UNLIM NAV_VTOL_LAND")
"""MAV_CMDs that bring a vehicle down, home or to a halt, whatever their parameters"""


def makes_safe(frame: Frame, dialect: Dialect, autopilot: Autopilot) -> bool:
    """Whether a station's frame can only land, return, halt or (unforced) disarm the vehicle."""
    name = dialect.name_of(frame.msgid)
    if name not in ("SET_MODE", "COMMAND_LONG", "COMMAND_INT"):
        return False
    fields: Mapping[str, Any] = decode(frame, dialect)
    if name == "SET_MODE":
        return _is_safe_mode(autopilot, int(fields["custom_mode"]))
    command = dialect.enum_name("MAV_CMD", fields["command"])
    if command == "MAV_CMD_DO_SET_MODE":
        # A main and a sub mode (PX4) or a number (ArduPilot): as the autopilot's own table has them.
        asked = tuple(float(fields[f"param{n}"]) for n in (2, 3))
        safe = (autopilot.mode(mode).command.padded()[1:3] for mode in _safe_modes(autopilot))
        return any(asked[: 2 if each[1] else 1] == each[: 2 if each[1] else 1] for each in safe)
    if command == "MAV_CMD_COMPONENT_ARM_DISARM":
        return bool(fields["param1"] == 0.0 and fields["param2"] == 0.0)
    if command == "MAV_CMD_DO_PAUSE_CONTINUE":
        return bool(fields["param1"] == 0.0)
    return command in _SAFE


def _is_safe_mode(autopilot: Autopilot, custom: int) -> bool:
    return any(autopilot.mode(mode).custom == custom for mode in _safe_modes(autopilot))


_SAFE_MODES = ("SMART_RTL", "QLAND", "QRTL", "BRAKE")
"""what lands, returns or halts it beside the modes that we ask for"""


def _safe_modes(autopilot: Autopilot) -> set[str]:
    named = (autopilot.land, autopilot.rtl, autopilot.loiter, autopilot.hold_mode)
    found = (autopilot.modes().keys() & set(_SAFE_MODES)) | {mode_of(name) for name in named}
    # Where it is held in the mode that follows setpoints, they go on.
    return {mode for mode in found if mode in autopilot.modes() and mode != mode_of(lambda: autopilot.guided)}


def by_command(autopilot: Autopilot, what: str) -> tuple[str, ...]:
    """Modes that an order changes to by itself, without a mode ordered by name; ``what``: its verb or its MAV_CMD."""
    return _ANY.get(autopilot.name, ()) if what in _CHANGING else _BY_VERB.get(autopilot.name, {}).get(what, ())
