"""Writes ArduPilot's dataflash log format: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html

Every message is 0xA3 0x95, its type, and its fields; the FMT messages at the beginning say what each type holds, UNIT,
MULT and FMTU in which units.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple

HEAD = b"\xa3\x95"
_FMT, _FMTU, _MULT, _UNIT = 128, 129, 130, 131
_FIRST = 132
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
_UNITS = {
    "-": "",
    "s": "s",
    "d": "deg",
    "h": "degheading",
    "D": "deglatitude",
    "U": "deglongitude",
    "m": "m",
    "n": "m/s",
    "v": "V",
    "A": "A",
    "a": "Ah",
    "S": "satellites",
    "#": "instance",
    "%": "%",
}
_MULTS = {"-": 0.0, "?": 1.0, "0": 1.0, "F": 1e-6, "C": 1e-3, "B": 1e-2, "G": 1e-7}


class Layout(NamedTuple):
    """One kind of message: a letter a field, the fields' names, their units and their multipliers."""

    name: str
    letters: str
    labels: str
    units: str
    mults: str

    @property
    def struct(self) -> struct.Struct:
        return struct.Struct("<2sB" + "".join(_CODES[letter] for letter in self.letters))


_OWN = (
    (_FMT, Layout("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----")),
    (_FMTU, Layout("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---")),
    (_MULT, Layout("MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--")),
    (_UNIT, Layout("UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--")),
)


class DataflashWriter:
    """A growing log of ``layouts``; ``data`` is always whole messages, and at most ``limit`` bytes."""

    def __init__(self, layouts: tuple[Layout, ...], time_us: int, limit: int) -> None:
        self.data = bytearray()
        self.full = False
        self._limit = limit
        numbered = (*_OWN, *((_FIRST + i, layout) for i, layout in enumerate(layouts)))
        self._types = {layout.name: (number, layout, layout.struct) for number, layout in numbered}
        for number, layout in numbered:
            self.write("FMT", number, layout.struct.size, layout.name, layout.letters, layout.labels)
        for letter, label in _UNITS.items():
            self.write("UNIT", time_us, ord(letter), label)
        for letter, factor in _MULTS.items():
            self.write("MULT", time_us, ord(letter), factor)
        for number, layout in numbered:
            self.write("FMTU", time_us, number, layout.units, layout.mults)

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
