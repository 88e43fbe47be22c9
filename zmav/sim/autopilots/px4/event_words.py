"""The file of words for the events that this PX4 sends, in the format of libevents: its own words, not PX4's.

https://github.com/mavlink/libevents (version 2). PX4 keeps such a file, made for its very build, where MAVFTP finds it.
"""

from __future__ import annotations

import functools
import json
import lzma
from typing import Any

from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.failsafe import Action, Cause
from zmav.sim.autopilots.px4.modes import MODES

_MODE, _ACTION, _CAUSE = ("uint32_t", "mode"), ("px4::failsafe_action_t", "action"), ("px4::failsafe_cause_t", "cause")
_SECONDS = ("uint16_t", "delay")
_REASON = ("px4::arm_disarm_reason_t", "reason")
_APPENDS = "append_health_and_arming_messages"
_CHECK = (("navigation_mode_group_t", "modes"), ("uint8_t", "health_component_index"))
_SETS = [
    (f"px4::{name}", f"set{i}") for i, name in enumerate(["health_component_t"] * 3 + ["navigation_mode_group_t"] * 2)
]

# Message, arguments, and whether what stands against the mode is to be appended.
_EVENTS: dict[str, tuple[str, tuple[tuple[str, str], ...], bool]] = {
    "commander_arm_denied_resolve_failures": ("Not armed: a health or arming check fails", (), False),
    "commander_armed_by": ("Armed, by {1}", (_REASON,), False),
    "commander_disarmed_by": ("Disarmed, by {1}", (_REASON,), False),
    "navigator_takeoff_default_alt": ("Takeoff to the default height of {1:.2m_v}", (("float", "height"),), False),
    "commander_takeoff_detected": ("Off the ground", (), False),
    "commander_landing_detected": ("On the ground", (), False),
    "commander_rc_lost": ("Sticks lost", (), False),
    "commander_dl_lost": ("Ground station lost", (), False),
    "commander_dl_regained": ("Ground station heard again", (), False),
    "check_estimator_gnss_fusion_stopped": ("The estimator goes on without GNSS", (), False),
    "check_estimator_gnss_fusion_started": ("The estimator uses GNSS", (), False),
    "navigator_geofence_invalid_against_home": ("Geofence not taken: home is outside", (), False),
    "navigator_geofence_invalid_against_cur_pos": ("Geofence not taken: the vehicle is outside", (), False),
    "navigator_reposition_outside_geofence": ("Not flown: the place is outside the geofence", (), False),
    "commander_failsafe_enter_generic": ("Failsafe: now {2}", (_MODE, _ACTION), True),
    "commander_failsafe_enter": ("{3}: now {2}", (_MODE, _ACTION, _CAUSE), False),
    "commander_failsafe_enter_generic_hold": ("Failsafe: {2} in {3} s", (_MODE, _ACTION, _SECONDS), True),
    "commander_failsafe_enter_hold": ("{4}: {2} in {3} s", (_MODE, _ACTION, _SECONDS, _CAUSE), False),
    "commander_failsafe_enter_generic_warn": ("Failsafe, nothing is done:", (_MODE,), True),
    "commander_failsafe_enter_warn": ("{2}: nothing is done", (_MODE, _CAUSE), False),
    "commander_failsafe_enter_low_bat": ("Battery low: return", (), False),
    "commander_failsafe_enter_crit_bat_warn": ("Battery critical: land", (), False),
    "commander_failsafe_enter_crit_low_bat_warn": ("Battery nearly empty: land at once", (), False),
}
_CHECKS = {
    "check_estimator_missing_data": "The estimator has not begun",
    "check_modes_cannot_takeoff": "This mode is not one to arm in",
    "check_modes_local_pos": "No local position",
    "check_modes_global_pos": "No global position",
    "check_modes_mission": "No mission to fly",
    "check_modes_home_position": "Home is not set",
    "check_modes_offboard_signal": "No setpoints for OFFBOARD",
    "check_modes_manual_control": "No sticks",
    "check_rc_dl_no_dllink": "No ground station is heard (<param>NAV_DLL_ACT</param>)",
    "check_estimator_gps_fix_too_low": "GPS fix too low",
    "check_battery_emergency": "Battery nearly empty",
    "check_battery_critical": "Battery critical",
    "check_battery_low": "Battery low",
    "check_gf_violation_max_hor_dist": "Further from home than the geofence allows",
    "check_gf_violation_max_alt": "Higher above home than the geofence allows",
    "check_gf_violation_custom_gf": "Near the geofence or outside it",
}
_REASONS = {
    events.EXTERNAL: "a command",
    events.LANDING: "landing",
    events.PREFLIGHT: "standing too long",
    events.LOCKDOWN: "lockdown",
    events.FAILURE: "the failure detector",
}


@functools.cache
def packed() -> bytes:
    """The file as MAVFTP gives it."""
    return lzma.compress(json.dumps(_file()).encode(), lzma.FORMAT_XZ, preset=9)


def _file() -> dict[str, Any]:
    default = {
        name: _event(name, text, given, _APPENDS if more else "") for name, (text, given, more) in _EVENTS.items()
    }
    checks = {name: _event(name, text, _CHECK) for name, text in _CHECKS.items()}
    chunk = ("uint8_t", "chunk_idx")
    arming = _event("commander_arming_check_summary", "Arming checks", (chunk, *_SETS[1:]), "summary")
    health = _event("commander_health_summary", "Health", (chunk, *_SETS[:3]), "summary")
    groups = {"default": [*default.values()], "arming_check": [arming, *checks.values()], "health": [health]}
    px4 = {
        "namespace": "px4",
        "enums": {
            "navigation_mode_group_t": _enum({mode.bit: mode.name for mode in MODES}, "uint32_t", bits=True),
            "health_component_t": _enum({1 << bit: f"component {bit}" for bit in range(31)}, "uint32_t", bits=True),
            "arm_disarm_reason_t": _enum(_REASONS),
            "failsafe_action_t": _enum({action: action.name for action in Action}),
            "failsafe_cause_t": _enum({cause: cause.name.replace("_", " ").capitalize() for cause in Cause}),
        },
        "event_groups": {
            group: {"events": {str(events.event_id(each["name"]) & 0xFFFFFF): each for each in found}}
            for group, found in groups.items()
        },
        "navigation_mode_groups": {"groups": {str(mode.number): [mode.custom] for mode in MODES}},
    }
    return {"version": 2, "components": {"1": px4}}


def _event(name: str, message: str, arguments: tuple[tuple[str, str], ...], kind: str = "") -> dict[str, Any]:
    given = [{"type": each, "name": called} for each, called in arguments]
    return {"name": name, "message": message, "arguments": given, **({"type": kind} if kind else {})}


def _enum(entries: dict[int, str], of: str = "uint8_t", *, bits: bool = False) -> dict[str, Any]:
    told = {str(int(value)): {"name": text.lower(), "description": text} for value, text in entries.items()}
    return {"type": of, "is_bitfield": bits, "entries": told}
