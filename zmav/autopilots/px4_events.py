"""The words for PX4's events (EVENT), which come as numbers: those that are usual, by PX4's names for them.

What is not here is shown by its number. Names: PX4's calls of ``events::ID``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from zmav.mavlink.event import event_id


def _by_id(words: Mapping[str, str]) -> dict[int, tuple[str, str]]:
    return {event_id(name): (name, text) for name, text in words.items()}


ARMING_SUMMARY, HEALTH_SUMMARY = event_id("commander_arming_check_summary"), event_id("commander_health_summary")
"""the first and the last event of a report of health and arming checks"""

EVENTS: Mapping[int, tuple[str, str]] = _by_id(
    {
        "commander_arm_denied_resolve_failures": "Not armed: a health or arming check fails",
        "commander_armed_by": "Armed",
        "commander_disarmed_by": "Disarmed",
        "navigator_takeoff_default_alt": "Takeoff to the default height",
        "commander_takeoff_detected": "Off the ground",
        "commander_landing_detected": "On the ground",
        "commander_rc_lost": "Sticks lost",
        "commander_dl_lost": "Ground station lost",
        "commander_dl_regained": "Ground station heard again",
        "check_estimator_gnss_fusion_stopped": "The estimator goes on without GNSS",
        "check_estimator_gnss_fusion_started": "The estimator uses GNSS",
        "check_estimator_gnss_warning_spoofing": "The GNSS signal is spoofed",
        "check_estimator_gnss_warning_jamming": "The GNSS signal is jammed",
        "navigator_geofence_invalid_against_home": "Geofence not taken: home is outside",
        "navigator_geofence_invalid_against_cur_pos": "Geofence not taken: the vehicle is outside",
        "navigator_reposition_outside_geofence": "Not flown: the place is outside the geofence",
        "commander_failsafe_enter_generic": "Failsafe",
        "commander_failsafe_enter": "Failsafe",
        "commander_failsafe_enter_generic_hold": "Failsafe",
        "commander_failsafe_enter_hold": "Failsafe",
        "commander_failsafe_enter_generic_warn": "Failsafe, nothing is done",
        "commander_failsafe_enter_warn": "Failsafe, nothing is done",
        "commander_failsafe_enter_low_bat": "Battery low: return",
        "commander_failsafe_enter_crit_bat_warn": "Battery critical: land",
        "commander_failsafe_enter_crit_low_bat_warn": "Battery nearly empty: land at once",
    }
)
WITH_CHECKS = frozenset(event_id(f"commander_failsafe_enter_generic{end}") for end in ("", "_hold", "_warn"))
"""what failed checks are the cause of; the first argument (uint32) is the custom mode that they stand against"""

ACTIONS = ("", "a warning", "POSCTL", "ALTCTL", "STABILIZED", "HOLD", "RTL", "LAND", "DESCEND", "disarmed", "the end")
CAUSES = ("", "Sticks lost", "Ground station lost", "Battery low", "Battery critical", "Battery empty", "Time is low")
"""PX4's failsafe_action_t and failsafe_cause_t"""
_FAILSAFES = {
    event_id(f"commander_failsafe_enter{end}"): (struct.Struct(layout), fields)
    for end, layout, fields in (
        ("", "<4xBB", ("action", "cause")),
        ("_hold", "<4xBHB", ("action", "delay", "cause")),
        ("_warn", "<4xB", ("cause",)),
        ("_generic", "<4xB", ("action",)),
        ("_generic_hold", "<4xBH", ("action", "delay")),
    )
}
"""what follows the custom mode in the arguments"""


def event_text(number: int, arguments: bytes) -> str:
    """What an event of ``EVENTS`` says, a failsafe with its cause and with what PX4 does and when."""
    text = EVENTS[number][1]
    layout, names = _FAILSAFES.get(number, (None, ()))
    if layout is None or len(arguments) < layout.size:
        return text
    given = dict(zip(names, layout.unpack_from(arguments), strict=True))
    action, cause = given.get("action", 0), given.get("cause", 0)
    if cause:
        text = CAUSES[cause] if cause < len(CAUSES) else f"Failsafe (cause {cause})"
    does = ACTIONS[action] if action < len(ACTIONS) else f"action {action}"
    when = f"HOLD, and {does} in {given['delay']} s" if "delay" in given else f"now {does}"
    return f"{text}: {when}" if action else f"{text}; nothing is done" if cause else text


CHECKS: Mapping[int, tuple[str, str]] = _by_id(
    {
        "check_estimator_missing_data": "The estimator has not begun",
        "check_estimator_heading_not_stable": "The estimated heading is not valid",
        "check_estimator_hor_vel_not_stable": "The estimated horizontal velocity is not stable",
        "check_estimator_vert_vel_not_stable": "The estimated vertical velocity is not stable",
        "check_estimator_hor_pos_not_stable": "The estimated position is not stable",
        "check_estimator_hgt_not_stable": "The estimated height is not stable",
        "check_estimator_mag_interference": "The magnetic field is disturbed (COM_ARM_MAG_STR)",
        "check_estimator_gps_fix_too_low": "GPS fix too low",
        "check_estimator_gps_num_sats_too_low": "Too few GPS satellites",
        "check_estimator_gps_pdop_too_high": "GPS PDOP too high",
        "check_estimator_gps_hor_pos_err_too_high": "GPS error of the horizontal position too high",
        "check_estimator_gps_vert_pos_err_too_high": "GPS error of the height too high",
        "check_modes_cannot_takeoff": "This mode is not one to arm in",
        "check_modes_local_pos": "No local position",
        "check_modes_global_pos": "No global position",
        "check_modes_mission": "No mission to fly",
        "check_modes_home_position": "Home is not set",
        "check_modes_offboard_signal": "No setpoints for OFFBOARD",
        "check_modes_manual_control": "No sticks",
        "check_rc_dl_no_dllink": "No ground station is heard (NAV_DLL_ACT)",
        "check_mag_missing": "A compass is missing",
        "check_mag_no_data": "A compass gives no data",
        "check_mag_not_calibrated": "A compass is not calibrated",
        "check_mag_consistency": "The compasses differ",
        "check_accel_missing": "An accelerometer is missing",
        "check_accel_no_data": "An accelerometer gives no data",
        "check_accel_not_calibrated": "An accelerometer is not calibrated",
        "check_system_flight_term_active": "Flight termination is active",
        "check_system_usb_connected": "USB is connected (CBRK_USB_CHK)",
        "check_system_no_global_pos": "No global position (COM_ARM_WO_GPS)",
        "check_system_no_home_pos": "Home is not set (COM_ARM_WO_GPS)",
        "check_system_safety_button": "The safety button is not pressed",
        "check_avionics_power_missing": "No power module is connected (CBRK_SUPPLY_CHK)",
        "check_avionics_power_low": "The supply's voltage is low",
        "check_avionics_power_high": "The supply's voltage is high",
        "check_battery_emergency": "Battery nearly empty",
        "check_battery_critical": "Battery critical",
        "check_battery_low": "Battery low",
        "check_gf_violation_max_hor_dist": "Further from home than the geofence allows",
        "check_gf_violation_max_alt": "Higher above home than the geofence allows",
        "check_gf_violation_custom_gf": "Near the geofence or outside it",
    }
)

_BITS = (
    "MANUAL:0 ALTCTL:1 POSCTL:2 MISSION:3 HOLD:4 RTL:5 ACRO:10 TERMINATION:13 OFFBOARD:14 STABILIZED:15 TAKEOFF:17 "
    "LAND:18 FOLLOW:19 PRECLAND:20"
)
MODE_BITS: Mapping[str, int] = {mode: int(bit) for mode, bit in (each.split(":") for each in _BITS.split())}
"""the number of a mode's bit in the sets of modes that a report has: vehicle_status's NAVIGATION_STATE"""
