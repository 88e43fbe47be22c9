"""Writes PX4's log format ULog: https://docs.px4.io/main/en/dev_log/ulog_file_format.html

A header, then messages of size, type and body: flag bits, formats, information and parameters first, then which format
has which id, and the data.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

MAGIC = b"ULog\x01\x12\x35\x01"
_HEADER = struct.Struct("<8sQ")
_MESSAGE = struct.Struct("<HB")
_CODES = {
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
    "bool": "?",
    "char": "c",
}


class Topic(NamedTuple):
    """One kind of data: its name and its fields, each a type and a name, behind the ``timestamp`` all have."""

    name: str
    fields: tuple[tuple[str, str], ...]

    @property
    def format(self) -> str:
        inside = "".join(f"{kind} {name};" for kind, name in (("uint64_t", "timestamp"), *self.fields))
        return f"{self.name}:{inside}"

    @property
    def struct(self) -> struct.Struct:
        return struct.Struct("<HQ" + "".join(_CODES[kind] for kind, _ in self.fields))


class UlogWriter:
    """A growing log of ``topics``, begun at ``time_us`` since boot; at most ``limit`` bytes, always whole messages.

    ``info`` are texts such as ``sys_name``; ``params`` are int (int32_t) or float.
    """

    def __init__(
        self,
        topics: tuple[Topic, ...],
        time_us: int,
        limit: int,
        *,
        info: Mapping[str, str] | None = None,
        params: Mapping[str, float] | None = None,
    ) -> None:
        self.data = bytearray(_HEADER.pack(MAGIC, time_us))
        self.full = False
        self._limit = limit
        self._put("B", bytes(40))  # flag bits: nothing appended, no flags
        for topic in topics:
            self._put("F", topic.format.encode())
        for key, text in (info or {}).items():
            self._put("I", _keyed(f"char[{len(text.encode())}] {key}", text.encode()))
        for name, value in (params or {}).items():
            kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
            self._put("P", _keyed(f"{kind} {name}", struct.pack(code, value)))
        self._ids = {}
        for number, topic in enumerate(topics):
            self._put("A", struct.pack("<BH", 0, number) + topic.name.encode())
            self._ids[topic.name] = (number, topic.struct)

    def write(self, topic: str, time_us: int, *values: float) -> None:
        """One sample of a topic, its fields in order."""
        number, form = self._ids[topic]
        self._put("D", form.pack(number, time_us, *values))

    def text(self, level: int, time_us: int, text: str) -> None:
        """A logged string; ``level`` is a MAV_SEVERITY."""
        self._put("L", struct.pack("<BQ", ord("0") + level, time_us) + text.encode())

    def _put(self, kind: str, body: bytes) -> None:
        if self.full or len(self.data) + _MESSAGE.size + len(body) > self._limit:
            self.full = True
            return
        self.data += _MESSAGE.pack(len(body), ord(kind)) + body


def _keyed(key: str, value: bytes) -> bytes:
    return bytes((len(key.encode()),)) + key.encode() + value
