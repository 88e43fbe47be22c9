"""Writes ArduPilot's dataflash log format: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html

Every message is 0xA3 0x95, its type, and its fields; the FMT messages at the beginning say what each type holds.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

HEAD = b"\xa3\x95"
_FMT = 128
_CODES = {
    "b": "b",
    "B": "B",
    "H": "H",
    "I": "I",
    "Q": "Q",
    "f": "f",
    "d": "d",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
    "c": "h",
    "e": "i",
    "L": "i",
    "M": "B",
}
"""a field's letter -> struct's"""
_SCALE = {"c": 100.0, "e": 100.0, "L": 1e7}


class Layout(NamedTuple):
    """One kind of message: a letter a field, and the fields' names."""

    name: str
    letters: str
    labels: str

    @property
    def struct(self) -> struct.Struct:
        return struct.Struct("<2sB" + "".join(_CODES[letter] for letter in self.letters))


class DataflashWriter:
    """A growing log of ``layouts``; ``data`` is always whole messages, and at most ``limit`` bytes."""

    def __init__(self, layouts: tuple[Layout, ...], limit: int) -> None:
        self.data = bytearray()
        self.full = False
        self._limit = limit
        own = Layout("FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        numbered = tuple(enumerate((own, *layouts), _FMT))
        self._types = {layout.name: (number, layout, layout.struct) for number, layout in numbered}
        for number, layout in numbered:
            self.write("FMT", number, layout.struct.size, layout.name, layout.letters, layout.labels)

    def write(self, name: str, *values: float | str) -> None:
        """One message, its fields in order, in the units a reader sees; nothing once the log is full."""
        number, layout, form = self._types[name]
        if self.full or len(self.data) + form.size > self._limit:
            self.full = True
            return
        packed = [_packed(letter, value) for letter, value in zip(layout.letters, values, strict=True)]
        self.data += form.pack(HEAD, number, *packed)


def _packed(letter: str, value: float | str) -> float | int | bytes:
    if isinstance(value, str):
        return re.sub(r"[^\x20-\x7e]", "?", value).encode()
    if letter in "fd":
        return value
    return round(value * _SCALE.get(letter, 1.0))
