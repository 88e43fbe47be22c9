"""Writes PX4's log format ULog: https://docs.px4.io/main/en/dev_log/ulog_file_format.html

A header, then messages of size, type and body: flag bits, information and parameters first, then logged texts. Topics
are not logged here.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

MAGIC = b"ULog\x01\x12\x35\x01"
_HEADER = struct.Struct("<8sQ")
_MESSAGE = struct.Struct("<HB")


class UlogWriter:
    """A growing log, begun at ``time_us`` since boot; at most ``limit`` bytes, always whole messages.

    ``info`` are texts such as ``sys_name``; ``params`` are int (int32_t) or float.
    """

    def __init__(self, time_us: int, limit: int, *, info: Mapping[str, str], params: Mapping[str, float]) -> None:
        self.data = bytearray(_HEADER.pack(MAGIC, time_us))
        self.full = False
        self._limit = limit
        self._put("B", bytes(40))  # flag bits: nothing appended, no flags
        for key, text in info.items():
            self._put("I", _keyed(f"char[{len(text.encode())}] {key}", text.encode()))
        for name, value in params.items():
            kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
            self._put("P", _keyed(f"{kind} {name}", struct.pack(code, value)))

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
