"""Motion JPEG in an .avi: pictures as they came, nothing decoded. What is written stays readable if nobody ends it.

Source: Microsoft, "AVI RIFF File Reference". The lengths in the header are brought up to date once a second, so a
recorder that is killed leaves all but the last second; the index comes at the end, and players do without it.
"""

from __future__ import annotations

import struct
import time
from pathlib import Path

FULL = 1_900_000_000
"""bytes: the format's own limit is 2 GiB"""
EVERY = 1.0
"""s between two times that the header is brought up to date"""
INDEX = 0x10  # every picture stands by itself


class Avi:
    """One file of pictures of one size; raises OSError."""

    def __init__(self, path: Path, width: int, height: int, rate: float) -> None:
        self.count = 0
        self._size = width, height
        self._rate = rate
        self._offsets: list[tuple[int, int]] = []
        self._first = self._last = 0.0
        self._told = time.monotonic()
        self._file = path.open("wb")
        self._file.write(self._header(0))
        self._movi = self._file.tell() - 4
        self._file.flush()

    def add(self, jpeg: bytes, t: float) -> None:
        """One picture, taken at ``t`` (UTC seconds)."""
        self._first, self._last = (t if self.count == 0 else self._first), t
        self._offsets.append((self._file.tell() - self._movi, len(jpeg)))
        self._file.write(b"00dc" + struct.pack("<I", len(jpeg)) + jpeg + b"\0" * (len(jpeg) % 2))
        self.count += 1
        self._file.flush()
        if time.monotonic() - self._told > EVERY or self.count == 1:
            self._told = time.monotonic()
            self._tell(self._file.tell())

    @property
    def full(self) -> bool:
        return self._file.tell() > FULL

    def close(self) -> None:
        """With the index."""
        end = self._file.tell()
        entries = b"".join(b"00dc" + struct.pack("<III", INDEX, *each) for each in self._offsets)
        self._file.write(b"idx1" + struct.pack("<I", len(entries)) + entries)
        self._tell(end)
        self._file.close()

    def _tell(self, movi_end: int) -> None:
        """Bring the header up to date."""
        end = self._file.tell()
        self._file.seek(0)
        self._file.write(self._header(end - 8, movi_end - self._movi))
        self._file.seek(end)
        self._file.flush()

    def _header(self, riff: int, movi: int = 4) -> bytes:
        width, height = self._size
        span = self._last - self._first
        rate = (self.count - 1) / span if self.count > 1 and span > 0.0 else self._rate
        micro = round(1e6 / min(max(rate, 0.01), 1000.0))
        has_index = 0x10
        avih = struct.pack("<14I", micro, 0, 0, has_index, self.count, 0, 1, 0, width, height, 0, 0, 0, 0)
        strh = b"vidsMJPG" + struct.pack(
            "<10I4H", 0, 0, 0, micro, 1_000_000, 0, self.count, 0, 0xFFFFFFFF, 0, 0, 0, width, height
        )
        strf = struct.pack("<IiiHH4s5I", 40, width, height, 1, 24, b"MJPG", width * height * 3, 0, 0, 0, 0)
        stream = _list(b"strl", _chunk(b"strh", strh) + _chunk(b"strf", strf))
        head = _list(b"hdrl", _chunk(b"avih", avih) + stream)
        return b"RIFF" + struct.pack("<I", riff) + b"AVI " + head + b"LIST" + struct.pack("<I", movi) + b"movi"


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data


def _list(name: bytes, data: bytes) -> bytes:
    return _chunk(b"LIST", name + data)
