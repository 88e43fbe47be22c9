"""EVENT (410): what PX4 says by number instead of in words. Every dialect has it (:mod:`zmav.mavlink.definitions`).

https://mavlink.io/en/services/events.html.

Its words are in a file of the very firmware, https://github.com/mavlink/libevents, version 2: JSON, compressed by xz.
Events lie by component and group; each has a message, whose arguments are ``{1}``, ``{2:.1m}`` (index from 1, decimals,
unit), and whose tags are ``<profile name="...">``, ``<a href="...">`` and ``<param>``. An event's id is that of its
component in the high byte and of the event in the rest. The file comes over a radio from whatever answers there:
everything in it is bounded.
"""

from __future__ import annotations

import lzma
import math
import re
import struct
from typing import NamedTuple

import msgspec

from zmav.errors import BadMessage
from zmav.mavlink.frame import Frame

MSGID = 410
NAME = "EVENT"
_PAYLOAD = struct.Struct("<IIHBBB40s")
"""id, event_time_boot_ms, sequence, destination_component, destination_system, log_levels, arguments"""
PROTOCOL = 8
"""log levels from here on are not for people: 8 is for protocols, 9 is disabled"""


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


MOST_PACKED, MOST = 1 << 20, 8 << 20
"""bytes of the file, as it comes and as it is read"""
MEMORY = 80 << 20
"""bytes that unpacking may ask for: PX4's file names a dictionary of 64 MiB, and uses a hundredth of it"""
LONGEST = 1000
"""characters of a message; the format allows 120"""
PROFILE = "dev"
"""the reader that libevents takes for granted"""
CHECK_GROUPS = ("health", "arming_check")
SUMMARY, APPENDS_CHECKS = "summary", "append_health_and_arming_messages"

_FORMATS = {
    f"{sign}int{bits}_t": each
    for bits, pair in zip((8, 16, 32, 64), ("Bb", "Hh", "Ii", "Qq"), strict=True)
    for sign, each in zip(("u", ""), pair, strict=True)
} | {"float": "f"}
_TOKEN = re.compile(
    r"\\(?P<escaped>.)"
    r'|<(?P<tag>[a-z]+)(?: (?P<name>[a-z]+)="(?P<value>[^"]*)")?>(?P<content>.*?)</(?P=tag)>'
    r"|\{(?P<index>\d{1,2})(?::(?:\.(?P<decimals>\d{1,2}))?)?(?P<unit>m_v|m/s|m\^2|m|C)?\}",
    re.DOTALL,
)


class _Argument(msgspec.Struct):
    type: str


class _Template(msgspec.Struct):
    name: str
    message: str
    type: str = ""
    arguments: list[_Argument] = []


class _Group(msgspec.Struct):
    events: dict[str, _Template] = {}


class _Entry(msgspec.Struct):
    description: str = ""


class _Enum(msgspec.Struct):
    type: str
    is_bitfield: bool = False
    separator: str = "|"
    entries: dict[str, _Entry] = {}


class _Modes(msgspec.Struct):
    groups: dict[str, list[int]] = {}


class _Component(msgspec.Struct):
    namespace: str
    enums: dict[str, _Enum] = {}
    event_groups: dict[str, _Group] = {}
    navigation_mode_groups: _Modes = msgspec.field(default_factory=_Modes)


class _File(msgspec.Struct):
    version: int
    components: dict[str, _Component]


class Worded(NamedTuple):
    """An event with what its file says of it."""

    event: Event
    name: str
    group: str
    type: str
    values: tuple[float, ...]
    text: str


class EventWords:
    """All that one file says. Made by :meth:`unpack`."""

    def __init__(self, file: _File) -> None:
        self._templates = {
            int(component) << 24 | int(number): (each.namespace, group, template)
            for component, each in file.components.items()
            for group, events in each.event_groups.items()
            for number, template in events.events.items()
        }
        self._enums = {
            f"{c.namespace}::{name}": enum for c in file.components.values() for name, enum in c.enums.items()
        }
        self._modes = {
            mode: 1 << (int(number) & 63)
            for each in file.components.values()
            for number, modes in each.navigation_mode_groups.groups.items()
            for mode in modes
        }

    @classmethod
    def unpack(cls, data: bytes) -> EventWords:
        """Read the file as it came; raises :class:`BadMessage` for what is damaged, too large or of another format."""
        if len(data) > MOST_PACKED:
            raise BadMessage(f"the file of events has {len(data)} bytes; expected {MOST_PACKED} at most")
        try:
            unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MEMORY)
            text = unpacker.decompress(data, MOST)
            if not unpacker.eof:
                raise BadMessage(f"the file of events is cut off, or has more than {MOST} bytes")
            file = msgspec.json.decode(text, type=_File)
            if file.version < 1:
                raise BadMessage(f"the file of events is of version {file.version}; expected 1 or more")
            return cls(file)
        except (lzma.LZMAError, msgspec.MsgspecError, ValueError, RecursionError, MemoryError) as e:
            raise BadMessage(f"the file of events cannot be read: {e}") from e

    def of(self, event: Event) -> Worded | None:
        """The event in words; None where the file has none for it."""
        found = self._templates.get(event.id)
        if found is None:
            return None
        namespace, group, template = found
        enums = [self._enums.get(a.type) or self._enums.get(f"{namespace}::{a.type}") for a in template.arguments]
        types = [enum.type if enum else argument.type for enum, argument in zip(enums, template.arguments, strict=True)]
        values = _unpacked(types, event.arguments)
        told = [_told(value, enum) for value, enum in zip(values, enums, strict=False)]
        text = _rendered(template.message[:LONGEST], told) or template.name[:LONGEST]
        text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
        return Worded(event, template.name[:LONGEST], group, template.type, values, text[:LONGEST])

    def mode_bit(self, custom_mode: int) -> int | None:
        """Of HEARTBEAT's custom mode in the sets of modes of health and arming checks; None: the file does not say."""
        return self._modes.get(custom_mode)


def _unpacked(types: list[str], data: bytes) -> tuple[float, ...]:
    """The arguments in their order, without padding between them; up to the first that is not there in full."""
    values: list[float] = []
    at = 0
    for each in types:
        layout = struct.Struct("<" + _FORMATS.get(each, "Q"))
        if each not in _FORMATS or at + layout.size > len(data):
            break
        values += layout.unpack_from(data, at)
        at += layout.size
    return tuple(values)


def whole(value: float) -> int:
    """An entry's number, or bits; 0 for what is no number."""
    return int(value) if math.isfinite(value) else 0


def _told(value: float, enum: _Enum | None) -> float | str:
    """An argument as people read it: of an enum its description, of a set of bits all of theirs."""
    if enum is None:
        return value
    number = whole(value)
    bits = [1 << i for i in range(64) if number >> i & 1] if enum.is_bitfield else [number]
    known = enum.entries
    said = [known[str(bit)].description[:LONGEST] if str(bit) in known else f"(unknown: {bit})" for bit in bits]
    return enum.separator[:16].join(said)[:LONGEST]


def _rendered(message: str, values: list[float | str]) -> str:
    def one(match: re.Match[str]) -> str:
        if match["escaped"] is not None:
            return match["escaped"]
        if match["tag"] is not None:
            return _tag(match, values)
        index = int(match["index"]) - 1
        if not 0 <= index < len(values):
            return "?"
        value, unit = values[index], match["unit"]
        if isinstance(value, str):
            shown = value
        elif match["decimals"] is not None:
            shown = f"{value:.{match['decimals']}f}"
        else:
            shown = str(value) if isinstance(value, int) else f"{value:g}"
        return f"{shown} {unit.removesuffix('_v')}" if unit else shown

    return _TOKEN.sub(one, message)


def _tag(match: re.Match[str], values: list[float | str]) -> str:
    """What a tag encloses, as text; one that is not known goes with what it encloses."""
    tag, value, content = match["tag"], match["value"], match["content"]
    if tag == "profile":
        wanted = value is not None and (value[1:] != PROFILE if value.startswith("!") else value == PROFILE)
        return _rendered(content, values) if wanted else ""
    if tag == "a":
        return f"{content} ({value})" if value and value != content else content
    return content if tag == "param" else ""
