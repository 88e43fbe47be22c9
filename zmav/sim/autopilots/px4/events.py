"""The events (EVENT, 410) that this PX4 sends, with the ids, log levels and arguments of a recorded one.

Protocol: https://mavlink.io/en/services/events.html. The low half of a log level is the one for people outside, the
high half the autopilot's own; 8 is for protocols only.
"""

from __future__ import annotations

import struct

import msgspec


class Event(msgspec.Struct, frozen=True):
    """One kind of event, and the words that a ground station is sent beside it (empty: none)."""

    id: int
    levels: int
    text: str = ""
    severity: int = 6


ARM_DENIED = Event(0x0102089D, 0x62, "Arming denied: Resolve system health failures first\t", 2)
ARMED = Event(0x0190CAF3, 0x66, "Armed by external command\t")
DEFAULT_TAKEOFF = Event(0x013B2FC7, 0x66)
TAKEOFF_DETECTED = Event(0x01414569, 0x66, "Takeoff detected\t")
LANDING_DETECTED = Event(0x019638AC, 0x66, "Landing detected\t")
DISARMED = Event(0x01F46777, 0x66)
FAILSAFE = Event(0x01DEDBD0, 0x42, "Failsafe activated\t", 2)
# The report of the arming checks, sent as a whole whenever it changes.
ARMING_SUMMARY = Event(0x01A893E0, 0x88)
NO_MISSION = Event(0x0105C2D9, 0x66)
NO_OFFBOARD_SIGNAL = Event(0x012F1DC7, 0x33)
NO_GROUND_STATION = Event(0x0106ED29, 0x44)
HEALTH_SUMMARY = Event(0x011D3727, 0x88)

EXTERNAL, LANDING, PREFLIGHT = 4, 6, 7  # why it was armed or disarmed
DISARM_TEXTS = {
    EXTERNAL: "Disarmed by external command\t",
    LANDING: "Disarmed by landing\t",
    PREFLIGHT: "Disarmed by auto preflight disarming\t",
}


# The summary's bit sets of modes: in error, and those that can arm and run.
_SUMMARY = bytes.fromhex("000000000080000000b07b7f80b07b7f80")
_SUMMARY_LOST = bytes.fromhex("000000100080000000b03b7f80b03b7f80")


def arming_report(*, offboard_lost: bool) -> list[tuple[Event, bytes]]:
    """The report as recorded, with or without the stream that OFFBOARD needs."""
    report = [
        (ARMING_SUMMARY, _SUMMARY_LOST if offboard_lost else _SUMMARY),
        (NO_MISSION, bytes.fromhex("0800000014")),
    ]
    if offboard_lost:
        report.append((NO_OFFBOARD_SIGNAL, bytes.fromhex("0040000014")))
    report.append((NO_GROUND_STATION, bytes.fromhex("ffffffff07")))
    report.append((HEALTH_SUMMARY, bytes.fromhex("000a0c0238")))
    return report


def float_argument(value: float) -> bytes:
    """A number as an event carries it."""
    return struct.pack("<f", value)
