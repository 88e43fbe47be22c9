"""Read recordings: .tlog, the format of MAVProxy, Mission Planner and QGroundControl.

Each record is 8 bytes of big-endian microseconds since 1970 and one MAVLink 1 or 2 frame, with nothing between records:
https://mavlink.io/en/guide/serialization.html for the frame; the record is what pymavlink's mavlogfile writes.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from typing import BinaryIO

STAMP = struct.Struct(">Q")
LONGEST = STAMP.size + 280  # a signed MAVLink 2 frame with a full payload
AHEAD = 5 * LONGEST  # so much is in the buffer before anything is judged, unless the file ends
LATEST_US = 4_102_444_800_000_000  # the year 2100: a later stamp is no stamp
DAY_US = 86_400_000_000
CHUNK = 256 * 1024
V1, V2, _SIGNED = 0xFE, 0xFD, 0x01
_TORN = -1
_START = re.compile(rb"\x00[\x00-\x0e].{6}[\xfd\xfe]", re.DOTALL)  # a stamp before 2100 and the first byte of a frame


def frame_length(data: bytes | bytearray, at: int) -> int:
    """Length of the frame that begins at ``at``; 0 when none does, -1 when its header is not whole."""
    if data[at] == V1:
        return 8 + data[at + 1] if at + 1 < len(data) else -1
    if data[at] != V2:
        return 0
    if at + 2 >= len(data):
        return -1
    flags = data[at + 2]
    if flags & ~_SIGNED:
        return 0
    return 12 + data[at + 1] + (13 if flags & _SIGNED else 0)


class TlogReader:
    """Iterates over ``(microseconds, frame)``; damage is skipped, counted in ``skipped`` and told in ``trouble``.

    A record counts when the next one begins where it ends. Where that fails, reading goes on at the next place where
    several records follow one another; a good record before the damage is kept. Raises OSError when reading fails.
    ``stop`` is asked now and then, so that a reader lost in a huge file that is no recording can be ended.
    """

    def __init__(self, file: BinaryIO, stop: Callable[[], bool] = lambda: False, chunk: int = CHUNK) -> None:
        self._file, self._chunk = file, chunk
        self._stop = stop
        self._buffer = b""
        self._offset = 0  # of the buffer's first byte in the file
        self._eof = False
        self._last_us: int | None = None  # of the last good record
        self.records = 0
        self.skipped = 0  # bytes
        self.trouble: str | None = None  # the last damage met, with its place

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        at = 0
        while True:
            if len(self._buffer) - at < AHEAD and not self._eof:
                self._refill(at)
                at = 0
            if at >= len(self._buffer) or self._stop():
                return
            end = self._record_end(at)
            if end > 0 and self._follows(end):
                yield self._take(at, end)
                at = end
                continue
            # Either this record is damaged, or only what follows it. The next sound place tells which.
            sound = self._next_sound(at + 1)
            if 0 < end <= sound:
                yield self._take(at, end)
                at = end
            if at < sound:
                self._skip(at, sound, torn=end == _TORN and sound == len(self._buffer))
                at = sound

    def _refill(self, at: int) -> None:
        self._offset += at
        self._buffer = self._buffer[at:]
        while len(self._buffer) < AHEAD and not self._eof:
            more = self._file.read(self._chunk)
            self._eof = not more
            self._buffer += more

    def _take(self, at: int, end: int) -> tuple[int, bytes]:
        self.records += 1
        self._last_us = STAMP.unpack_from(self._buffer, at)[0]
        return self._last_us, self._buffer[at + STAMP.size : end]

    def _skip(self, at: int, end: int, torn: bool) -> None:
        self.skipped += end - at
        place = self._offset + at
        if torn:
            self.trouble = f"ends in the middle of a record: {end - at} bytes at offset {place} dropped"
        else:
            self.trouble = f"{end - at} bytes at offset {place} are no record: skipped"

    def _record_end(self, at: int) -> int:
        """Where the record at ``at`` ends; 0 when none begins there, -1 when it goes on behind the end of the file."""
        buffer = self._buffer
        head = at + STAMP.size
        if head + 3 > len(buffer):
            return _TORN
        if STAMP.unpack_from(buffer, at)[0] > LATEST_US:
            return 0
        length = frame_length(buffer, head)
        if length == 0:
            return 0
        return head + length if head + length <= len(buffer) else _TORN

    def _follows(self, end: int) -> bool:
        """Whether the file goes on at ``end`` as it should: with a record, a torn one, or not at all."""
        return end == len(self._buffer) or self._record_end(end) != 0

    def _next_sound(self, start: int) -> int:
        """The next place where records stand again, or where the buffer is no longer certain."""
        certain = len(self._buffer) if self._eof else len(self._buffer) - 3 * LONGEST
        at = start
        while found := _START.search(self._buffer, at, certain + STAMP.size):
            at = found.start()
            if self._is_sound(at):
                return at
            at += 1
        return certain

    def _is_sound(self, at: int) -> bool:
        """Whether records of about one time follow one another here, to the end of the file or far enough.

        Three are enough, or two of the time of the last good one. One is not: eight zeros and one byte look like it.
        """
        stamps: list[int] = []
        while len(stamps) < 3 and at < len(self._buffer):
            end = self._record_end(at)
            if end <= 0:
                break
            stamps.append(STAMP.unpack_from(self._buffer, at)[0])
            at = end
        if not stamps or max(stamps) - min(stamps) > DAY_US:
            return False
        in_time = self._last_us is not None and abs(stamps[0] - self._last_us) <= DAY_US
        return len(stamps) == 3 or (len(stamps) == 2 and in_time) or at == len(self._buffer)
