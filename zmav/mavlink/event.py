"""EVENT (410): what PX4 says by number instead of in words. Every dialect has it (:mod:`zmav.mavlink.definitions`).

https://mavlink.io/en/services/events.html.

An event's id is that of its component in the high byte, and a hash of its name in the rest.
"""

from __future__ import annotations

import struct

import msgspec

from zmav.mavlink.frame import Frame

MSGID = 410
NAME = "EVENT"
_PAYLOAD = struct.Struct("<IIHBBB40s")
"""id, event_time_boot_ms, sequence, destination_component, destination_system, log_levels, arguments"""
PROTOCOL = 8
"""log levels from here on are not for people: 8 is for protocols, 9 is disabled"""


_FNV_OFFSET, _FNV_PRIME = 0x811C9DC5, 0x01000193
_AUTOPILOT = 1 << 24


def event_id(name: str) -> int:
    """The id of PX4's event of that name: component 1, and the 32-bit FNV-1a hash cut to 24 bits."""
    value = _FNV_OFFSET
    for byte in name.encode("ascii"):
        value = (value ^ byte) * _FNV_PRIME & 0xFFFFFFFF
    return value & 0xFFFFFF | _AUTOPILOT


class Event(msgspec.Struct, frozen=True):
    """One event of an autopilot."""

    id: int
    """bits 24 to 31: the component that defines it (1: PX4's own); the rest: a hash of its name"""
    time_boot_ms: int
    sequence: int
    """rises by one each event, wraps at 65536"""
    level: int
    """MAV_SEVERITY for people outside the autopilot (0 to 7); 8 and 9: not for them"""
    log_level: int
    """as ``level``, for the autopilot's own log"""
    arguments: bytes

    @property
    def for_people(self) -> bool:
        return self.level < PROTOCOL

    def __str__(self) -> str:
        values = self.arguments.rstrip(b"\0").hex()
        return f"PX4 event 0x{self.id:08x}" + (f" ({values})" if values else "")


def read_event(frame: Frame) -> Event | None:
    """The event in a frame; None where it is no EVENT, or its checksum was not looked at."""
    if frame.msgid != MSGID or not frame.verified:
        return None
    payload = frame.payload[: _PAYLOAD.size].ljust(_PAYLOAD.size, b"\0")
    number, boot_ms, sequence, _component, _system, levels, arguments = _PAYLOAD.unpack(payload)
    return Event(number, boot_ms, sequence, levels & 0x0F, levels >> 4, arguments)
