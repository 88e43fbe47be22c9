"""Dialects: which messages and enums exist, and how a payload is laid out.

A :class:`Dialect` is a plain table. It is filled from pymavlink's generated modules (the message definitions everybody
shares); :mod:`zmav.mavlink.definitions` does the reading, on first use and not at import.
Format: https://mavlink.io/en/guide/xml_schema.html and https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

import operator
import struct
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from zmav.errors import BadMessage, did_you_mean

#: struct codes of MAVLink's field types; a char array is read as one string.
TYPE_CODES = {
    "char": "s",
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
}


class Field(msgspec.Struct, frozen=True):
    """One field of a message, as its definition declares it.

    ``type`` is the element's C type ("uint16_t", "char" ...); ``length`` the number of array elements, 0 for a scalar.
    ``units`` ("degE7", "m/s" ...) and ``enum`` ("MAV_TYPE") are "" where there are none; ``bitmask`` says that the
    enum's entries are flags to be combined; an ``extension`` field exists in MAVLink 2 only and may be absent (zero).
    An ``instance`` tells which of several a message is about: which battery, which motor.
    """

    name: str
    type: str
    length: int = 0
    units: str = ""
    enum: str = ""
    bitmask: bool = False
    extension: bool = False
    instance: bool = False

    @property
    def code(self) -> str:
        """The struct code of the whole field ("H", "4f", "16s")."""
        code = TYPE_CODES[self.type]
        if self.type == "char":
            return f"{self.length or 1}s"
        return f"{self.length}{code}" if self.length else code


class MessageType(msgspec.Struct, frozen=True):
    """A message's definition. ``fields`` are in declared order, ``wire_fields`` in the order of the payload.

    ``struct`` unpacks a whole payload, extensions included, ``max_length`` bytes; without extensions (MAVLink 1) a
    payload has ``base_length`` bytes. ``target_system`` and ``target_component`` are byte offsets into the payload, or
    None where the message has no such field.
    """

    id: int
    name: str
    crc_extra: int
    fields: tuple[Field, ...]
    wire_fields: tuple[Field, ...]
    struct: struct.Struct
    base_length: int
    max_length: int
    target_system: int | None
    target_component: int | None
    by_name: dict[str, Field]
    order: Callable[[tuple[Any, ...]], tuple[Any, ...]] | None
    """from the payload's order to the declared one, where each field is one number; None: it takes more"""
    enum_fields: tuple[Field, ...]
    units: dict[str, str]
    """of the fields that have some"""

    def __repr__(self) -> str:
        return f"<MessageType {self.name} ({self.id})>"

    @classmethod
    def build(cls, msgid: int, name: str, crc_extra: int, fields: list[Field], wire_order: list[str]) -> MessageType:
        """Lay out the payload; ``wire_order`` names the fields as they lie in it (base by size, then extensions)."""
        by_name = {field.name: field for field in fields}
        wire_fields = tuple(by_name[n] for n in wire_order)
        layout = struct.Struct("<" + "".join(f.code for f in wire_fields))
        base = struct.calcsize("<" + "".join(f.code for f in wire_fields if not f.extension))
        # MANUAL_CONTROL alone calls its target system just "target".
        system = "target" if name == "MANUAL_CONTROL" else "target_system"
        return cls(
            id=msgid,
            name=name,
            crc_extra=crc_extra,
            fields=tuple(fields),
            wire_fields=wire_fields,
            struct=layout,
            base_length=base,
            max_length=layout.size,
            target_system=_offset(wire_fields, system),
            target_component=_offset(wire_fields, "target_component"),
            by_name=by_name,
            order=_order(fields, wire_order),
            enum_fields=tuple(field for field in fields if field.enum),
            units={field.name: field.units for field in fields if field.units},
        )


def _order(fields: list[Field], wire_order: list[str]) -> Callable[[tuple[Any, ...]], tuple[Any, ...]] | None:
    if len(fields) < 2 or any(field.length or field.type == "char" for field in fields):
        return None
    return operator.itemgetter(*(wire_order.index(field.name) for field in fields))


def _offset(wire_fields: tuple[Field, ...], name: str) -> int | None:
    before = "<"
    for field in wire_fields:
        if field.name == name:
            return struct.calcsize(before)
        before += field.code
    return None


class Dialect(msgspec.Struct, frozen=True):
    """A set of messages and enums. ``enums`` maps an enum's name to {entry name: value}; ``source`` is its XML file."""

    name: str
    source: str
    by_id: dict[int, MessageType]
    by_name: dict[str, MessageType]
    enums: dict[str, dict[str, int]]
    enum_names: dict[str, dict[int, str]]

    def __repr__(self) -> str:  # the whole table would be megabytes
        return f"<Dialect {self.name}: {len(self.by_id)} messages, {len(self.enums)} enums>"

    @classmethod
    def build(cls, name: str, source: str, messages: list[MessageType], enums: dict[str, dict[str, int]]) -> Dialect:
        return cls(
            name=name,
            source=source,
            by_id={m.id: m for m in messages},
            by_name={m.name: m for m in messages},
            enums=enums,
            enum_names={
                enum: {value: entry for entry, value in sorted(entries.items(), key=operator.itemgetter(1))}
                for enum, entries in enums.items()
            },
        )

    def message(self, name_or_id: str | int) -> MessageType:
        """The message of that name or id; raises :class:`BadMessage`, which suggests names like it."""
        found = self.by_id.get(name_or_id) if isinstance(name_or_id, int) else self.by_name.get(str(name_or_id))
        if found is not None:
            return found
        raise self._lacks("a message", "name", name_or_id, self.by_name)

    def name_of(self, msgid: int) -> str:
        """The message's name, "UNKNOWN_44000" where the dialect lacks it."""
        found = self.by_id.get(msgid)
        return found.name if found is not None else f"UNKNOWN_{msgid}"

    def value(self, enum: str, name: str) -> int:
        """The number behind an enum's entry; raises :class:`BadMessage`, which suggests names like it."""
        entries = self.enums.get(enum)
        if entries is None:
            raise self._lacks("an enum", "enum", enum, self.enums)
        if name not in entries:
            text = f"{enum} has no entry {name!r}{did_you_mean(name.upper(), entries)}"
            raise BadMessage(text, field=enum, value=name, expected=f"an entry of {enum}")
        return entries[name]

    def _lacks(self, kind: str, field: str, value: str | int, known: Iterable[str]) -> BadMessage:
        article, noun = kind.split()
        text = f"dialect {self.name} has no {noun} {value!r}{did_you_mean(str(value).upper(), known)}"
        return BadMessage(text, field=field, value=value, expected=f"{article} {noun} of dialect {self.name}")

    def enum_name(self, enum: str, value: int) -> str | None:
        """The entry's name, or None where the enum or the entry is not known."""
        return self.enum_names.get(enum, {}).get(value)
