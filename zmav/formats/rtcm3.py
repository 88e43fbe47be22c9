"""RTCM 3 in bytes: where a message begins and ends, and the few of its fields by which corrections are judged.

A message on the wire (RTCM 10403.3, 4): the byte 0xD3, six bits of zero, ten bits of length, up to 1023 bytes, and a
CRC-24Q over all of it. What is inside is the receiver's own business; ``pyrtcm`` decodes it for people.
"""

from __future__ import annotations

import math
from typing import NamedTuple

PREAMBLE = 0xD3
HEAD, CHECK, MOST_INSIDE = 3, 3, 1023
MOST_MESSAGE = HEAD + MOST_INSIDE + CHECK
"""bytes of a message with all that is around it"""
MOST_DOUBTS = 16
"""false beginnings in a row that are looked at byte by byte; beyond them it is garbage, and skipped faster"""
_POLYNOMIAL = 0x1864CFB
_PLACES = (1005, 1006)
_MSM = range(1071, 1138)
"""multiple signal messages: GPS, GLONASS, Galileo, SBAS, QZSS, BeiDou, NavIC"""
_OBSERVATIONS = frozenset({*range(1001, 1005), *range(1009, 1013), *(n for n in _MSM if 1 <= n % 10 <= 7)})
_NAMES_STATION = frozenset({*_OBSERVATIONS, *range(1005, 1009), 1013, 1029, 1032, 1033, 1230})


def _table() -> tuple[int, ...]:
    found = []
    for byte in range(256):
        value = byte << 16
        for _ in range(8):
            value = value << 1 ^ (_POLYNOMIAL if value & 0x800000 else 0)
        found.append(value)
    return tuple(found)


_TABLE = _table()


def crc24q(data: bytes) -> int:
    """Qualcomm's CRC of 24 bits; zero over a whole message with its own."""
    value = 0
    for byte in data:
        value = value << 8 & 0xFFFFFF ^ _TABLE[value >> 16 ^ byte]
    return value


class Ecef(NamedTuple):
    """Earth-centred, earth-fixed, m."""

    x: float
    y: float
    z: float

    def distance(self, other: Ecef) -> float:
        return math.dist(self, other)


class Message(NamedTuple):
    """One message, whole and checked."""

    data: bytes

    @property
    def number(self) -> int:
        """Its type: 1005, 1077 and so on."""
        return self._bits(0, 12) if len(self.data) >= HEAD + 2 + CHECK else 0

    @property
    def station(self) -> int | None:
        """The reference station's id; None where this kind names none."""
        return self._bits(12, 12) if self.number in _NAMES_STATION and len(self.data) >= HEAD + 3 + CHECK else None

    @property
    def observes(self) -> bool:
        """It holds observations, which are what grows old; others say where the base is, or which antenna it has."""
        return self.number in _OBSERVATIONS

    @property
    def place(self) -> Ecef | None:
        """Where the base's antenna is, by 1005 and 1006; None of others, and where it is in the middle of the earth."""
        if self.number not in _PLACES or len(self.data) < HEAD + 19 + CHECK:
            return None
        found = Ecef(*(self._signed(at, 38) * 1e-4 for at in (34, 74, 114)))
        return found if any(found) else None

    def _bits(self, at: int, count: int) -> int:
        """An unsigned number of so many bits, from a bit of the content on."""
        inside = self.data[HEAD + at // 8 : HEAD + (at + count + 7) // 8]
        spare = len(inside) * 8 - at % 8 - count
        return int.from_bytes(inside, "big") >> spare & (1 << count) - 1

    def _signed(self, at: int, count: int) -> int:
        value = self._bits(at, count)
        return value - (1 << count) if value >> count - 1 else value


class Cutter:
    """Finds messages in whatever comes: ``feed`` gives those that are whole. It keeps less than one message.

    ``skipped``: bytes of none, ``wrong``: beginnings whose CRC was wrong.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._doubts = 0
        self.skipped = self.wrong = 0

    def feed(self, data: bytes) -> list[Message]:
        data, self._rest = self._rest + data, b""
        found, at = list[Message](), 0
        while True:
            begin = data.find(PREAMBLE, at)
            self.skipped += (begin if begin >= 0 else len(data)) - at
            if begin < 0:
                return found
            at = begin
            if len(data) - at < HEAD:
                break
            length = int.from_bytes(data[at + 1 : at + HEAD], "big")
            if length > MOST_INSIDE:
                at = self._skip(at, 1)
                continue
            end = at + HEAD + length + CHECK
            if end > len(data):
                break
            if length and crc24q(data[at:end]) == 0:
                found.append(Message(data[at:end]))
                self._doubts, at = 0, end
                continue
            self.wrong += 1
            self._doubts += 1
            at = self._skip(at, 1 if self._doubts <= MOST_DOUBTS else end - at)
        self._rest = data[at:]
        return found

    def _skip(self, at: int, count: int) -> int:
        self.skipped += count
        return at + count


def split(data: bytes) -> list[Message] | None:
    """The messages that ``data`` is made of; None where it is anything besides."""
    cutter = Cutter()
    found = cutter.feed(data)
    return found if sum(len(each.data) for each in found) == len(data) else None


def frame(inside: bytes) -> bytes:
    """A message with that content, of at most 1023 bytes."""
    data = bytes((PREAMBLE,)) + len(inside).to_bytes(2, "big") + inside
    return data + crc24q(data).to_bytes(CHECK, "big")
