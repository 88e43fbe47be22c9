"""The events (EVENT, 410) that this PX4 sends, with PX4's ids and log levels, and the words that go beside them.

Protocol: https://mavlink.io/en/services/events.html. Ids, levels and arguments agree with a recorded flight. The low
half of a log level is the one for people outside, the high half the autopilot's own; 8 is for protocols only.
"""

from __future__ import annotations

import struct

import msgspec

from zmav.mavlink.event import event_id


class Event(msgspec.Struct, frozen=True):
    """One kind of event, and the words that a ground station is sent beside it (empty: none)."""

    id: int
    levels: int
    text: str = ""
    severity: int = 6


def _event(name: str, levels: int, text: str = "", severity: int = 6) -> Event:
    return Event(event_id(name), levels, text, severity)


ARM_DENIED = _event(
    "commander_arm_denied_resolve_failures", 0x62, "Arming denied: Resolve system health failures first\t", 2
)
ARMED = _event("commander_armed_by", 0x66, "Armed by external command\t")
DEFAULT_TAKEOFF = _event("navigator_takeoff_default_alt", 0x66)
TAKEOFF_DETECTED = _event("commander_takeoff_detected", 0x66, "Takeoff detected\t")
LANDING_DETECTED = _event("commander_landing_detected", 0x66, "Landing detected\t")
DISARMED = _event("commander_disarmed_by", 0x66)
MANUAL_LOST = _event("commander_rc_lost", 0x66, "Manual control lost\t")
GCS_LOST = _event("commander_dl_lost", 0x66, "Connection to ground control station lost\t")
GCS_REGAINED = _event("commander_dl_regained", 0x66, "GCS connection regained\t")
GNSS_STOPPED = _event("check_estimator_gnss_fusion_stopped", 0x63, "GNSS data fusion stopped\t", 4)
GNSS_STARTED = _event("check_estimator_gnss_fusion_started", 0x66, "GNSS data fusion started\t")
FENCE_WITHOUT_HOME = _event(
    "navigator_geofence_invalid_against_home", 0x42, "Geofence invalid, doesn't contain Home position\t", 2
)
FENCE_WITHOUT_VEHICLE = _event(
    "navigator_geofence_invalid_against_cur_pos",
    0x42,
    "Geofence invalid, doesn't contain current vehicle position\t",
    2,
)
OUTSIDE_FENCE = _event("navigator_reposition_outside_geofence", 0x63, "Reposition is outside geofence\t", 2)
# What a failsafe says: with a delay or without, with its cause or without, and where it only warns.
_ACTIVATED = "Failsafe activated\t"
FAILSAFE = _event("commander_failsafe_enter_generic", 0x42, _ACTIVATED, 2)
FAILSAFE_CAUSED = _event("commander_failsafe_enter", 0x42, _ACTIVATED, 2)
FAILSAFE_HOLD = _event("commander_failsafe_enter_generic_hold", 0x42)
FAILSAFE_HOLD_CAUSED = _event("commander_failsafe_enter_hold", 0x42)
FAILSAFE_WARNS = _event("commander_failsafe_enter_generic_warn", 0x44, _ACTIVATED, 2)
FAILSAFE_WARNS_CAUSED = _event("commander_failsafe_enter_warn", 0x44, _ACTIVATED, 2)
BATTERY_LOW = _event("commander_failsafe_enter_low_bat", 0x64, _ACTIVATED, 2)
BATTERY_CRITICAL = _event("commander_failsafe_enter_crit_bat_warn", 0x62, _ACTIVATED, 2)
BATTERY_EMERGENCY = _event("commander_failsafe_enter_crit_low_bat_warn", 0x60, _ACTIVATED, 2)
# The report of the arming checks, sent as a whole whenever it changes: its head and its foot.
ARMING_SUMMARY = _event("commander_arming_check_summary", 0x88)
HEALTH_SUMMARY = _event("commander_health_summary", 0x88)

EXTERNAL, LANDING, PREFLIGHT, LOCKDOWN, FAILURE = 4, 6, 7, 9, 10  # why it was armed or disarmed
DISARM_TEXTS = {
    EXTERNAL: "Disarmed by external command\t",
    LANDING: "Disarmed by landing\t",
    PREFLIGHT: "Disarmed by auto preflight disarming\t",
    LOCKDOWN: "Disarmed by lockdown\t",
    FAILURE: "Disarmed by failure detector\t",
}


def float_argument(value: float) -> bytes:
    """A number as an event carries it."""
    return struct.pack("<f", value)
