"""Frames: find MAVLink 1 and 2 frames in a stream of bytes, check them once, count what was wrong and what was lost.

Packet formats: https://mavlink.io/en/guide/serialization.html#mavlink2_packet_format
"""

from __future__ import annotations

import functools
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from zmav.mavlink.checksum import BEFORE_MAGIC_V2, checksum, crc, residue_of, residues
from zmav.mavlink.dialect import Dialect, MessageType
from zmav.mavlink.frame import (
    CHECKSUM,
    HEADER_V1,
    HEADER_V2,
    MAGIC_V1,
    MAGIC_V2,
    SIGNATURE,
    SIGNED,
    Frame,
    build_frame,
    parse_frame,
)

__all__ = ["Frame", "SourceCounters", "SplitCounters", "Splitter", "build_frame", "parse_frame"]

_SHORTEST_V2 = HEADER_V2 + CHECKSUM
_LONGEST_UNSIGNED_V2 = HEADER_V2 + 255 + CHECKSUM

_ANY_MAGIC = re.compile(b"[\xfd\xfe]")
_MAX_ROUTES = 4096
_LATE = 32  # how many numbers back a frame counts as late and not as a restart


# The counters are dataclasses and not Structs for speed: setting a Struct's field costs three times as much.
@dataclass(slots=True)
class SplitCounters:
    """What a splitter has seen; ``bytes`` are all either in ``frames``, or ``garbage``, or of a frame not yet whole."""

    bytes: int = 0
    frames: int = 0
    bad_crc: int = 0  # places where a frame seemed to begin, but the checksum was wrong
    bad_length: int = 0  # ... a MAVLink 1 frame that was too short for its message
    bad_flags: int = 0  # ... a frame with an incompatibility flag that is not understood
    unknown: int = 0  # frames whose message the dialect lacks
    garbage: int = 0  # bytes passed over
    lost: int = 0  # frames missing by the sequence numbers of all sources


@dataclass(slots=True)
class SourceCounters:
    """What one (system, component) has sent. ``last_seq`` is that of its newest frame."""

    frames: int = 0
    lost: int = 0
    last_seq: int = -1


class Splitter:
    """Cuts one stream of bytes into frames. The result depends on the stream alone, never on how it was chopped.

    A frame counts as one when its message is known and its checksum right. One whose message the dialect lacks cannot
    be checked: it is taken on trust, but only where the byte before it ended a frame, or at the stream's start. Out of
    step (after garbage or a damaged frame) such frames are passed over until a checked one is found. A frame with an
    incompatibility flag other than "signed" is refused, since nobody knows where it ends: the drafts of MAVLink 2.1
    (SYSID32 and TARGETTED, pymavlink#1229) lengthen the header that way. A payload longer than the dialect's (newer
    extension fields) is fine.

    Losses are gaps in the sequence numbers, which each (system, component) counts modulo 256. A frame from up to 32
    back is a duplicate, or was overtaken: if it had been counted as lost, it no longer is. Any other gap of 128 and
    more is a restart, or an outage too long for eight bits to tell, and no loss; a restart can look like a loss of up
    to 127 frames. Only checked frames make a new entry in ``sources``, so that garbage cannot.

    One thread at a time may use a splitter. Memory is bounded: at most one unfinished frame is kept.
    """

    def __init__(self, dialect: Dialect) -> None:
        self.counters = SplitCounters()
        self.sources: dict[tuple[int, int], SourceCounters] = {}
        self._messages = dialect.by_id
        self.partial = b""
        """of a frame of which the rest has not come"""
        self._in_sync = True
        # What the fast paths need to know of a frame, by its bytes 5 to 9: system, component and message id. It fills
        # as frames come by the general path, and is emptied when somebody invents ids without end.
        self._routes: dict[bytes, tuple[int, int, SourceCounters]] = {}
        # By system and component: the numbers counted as lost that may only be late.
        self._missing: dict[bytes, set[int]] = {}
        self._layouts = _layouts()
        self._residues = residues()

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes of the stream; returns the frames that are now whole, in order. Never raises."""
        # The fast path: a datagram that is one whole unsigned MAVLink 2 frame. Everything else is for _split.
        size = len(data)
        if not self.partial and _SHORTEST_V2 <= size <= _LONGEST_UNSIGNED_V2:
            unpack, expected = self._layouts[size]
            head, seq, key, checked = unpack(data)
            if head == expected:
                route = self._routes.get(key)
                if route is not None:
                    extra, msgid, source = route
                    if crc(data, BEFORE_MAGIC_V2) ^ extra == self._residues[checked]:
                        if seq == source.last_seq + 1:
                            source.last_seq = seq
                        else:
                            self._jump(key[:2], source, seq)
                        source.frames += 1
                        counters = self.counters
                        counters.bytes += size
                        counters.frames += 1
                        self._in_sync = True
                        return [Frame(data, msgid, True)]
        return self._split(data)

    def reset(self) -> None:
        """Forget an unfinished frame: the link was reopened, and a new stream begins. Counters and sources stay."""
        self.counters.garbage += len(self.partial)
        self.partial = b""
        self._in_sync = True

    def _split(self, data: bytes) -> list[Frame]:
        buf = self.partial + data if self.partial else data
        size = len(buf)
        pos = 0
        frames: list[Frame] = []
        while pos < size:
            pos = self._run(buf, pos, frames)
            if pos == size or (self._in_sync and _is_unfinished(buf, pos)):
                break
            taken = self._examine(buf, pos, frames)
            if taken == 0:
                break
            self._in_sync = taken > 0
            pos += abs(taken)
        self.partial = buf[pos:]
        self.counters.bytes += len(data)
        self.counters.frames += len(frames)
        return frames

    def _run(self, buf: bytes, pos: int, frames: list[Frame]) -> int:
        """Take frames like the fast path's for as long as they follow each other; returns where that ended."""
        layouts, table, routes = self._layouts, self._residues, self._routes
        total = len(buf)
        last = total - _SHORTEST_V2
        start = pos
        try:
            while pos <= last:
                size = _SHORTEST_V2 + buf[pos + 1]
                end = pos + size
                if end > total:
                    break
                data = buf[pos:end]
                unpack, expected = layouts[size]
                head, seq, key, checked = unpack(data)
                if head != expected:
                    break
                extra, msgid, source = routes[key]
                if crc(data, BEFORE_MAGIC_V2) ^ extra != table[checked]:
                    break
                if seq == source.last_seq + 1:
                    source.last_seq = seq
                else:
                    self._jump(key[:2], source, seq)
                source.frames += 1
                frames.append(Frame(data, msgid, True))
                pos = end
        except KeyError:  # a new route: the general path will add it
            pass
        if pos > start:
            self._in_sync = True
        return pos

    def _examine(self, buf: bytes, pos: int, frames: list[Frame]) -> int:
        """The general path, for any byte: the length of the frame there, which then is the last of ``frames``; or minus
        the number of bytes to pass over; or 0 where more bytes are needed to tell.

        Every verdict is given on as few bytes as it takes, in this order, so that chopping cannot change it.
        """
        magic = buf[pos]
        if magic != MAGIC_V2 and magic != MAGIC_V1:
            following = _ANY_MAGIC.search(buf, pos)
            return self._pass_over((following.start() if following else len(buf)) - pos)
        have = len(buf) - pos
        signed = False
        if magic == MAGIC_V2 and have > 2:
            if buf[pos + 2] & ~SIGNED:
                self.counters.bad_flags += 1
                return self._pass_over(1)
            signed = buf[pos + 2] == SIGNED
        header = HEADER_V2 if magic == MAGIC_V2 else HEADER_V1
        if have < header:
            return 0
        payload = buf[pos + 1]
        msgid = int.from_bytes(buf[pos + 7 : pos + 10], "little") if magic == MAGIC_V2 else buf[pos + 5]
        message = self._messages.get(msgid)
        if message is None:
            if not self._in_sync:
                return self._pass_over(1)
        elif magic == MAGIC_V1 and payload < message.base_length:
            self.counters.bad_length += 1
            return self._pass_over(1)
        length = header + payload + CHECKSUM + (SIGNATURE if signed else 0)
        if have < length:
            return 0
        end = pos + header + payload
        if message is not None and checksum(buf[pos + 1 : end], message.crc_extra) != buf[end] | buf[end + 1] << 8:
            self.counters.bad_crc += 1
            return self._pass_over(1)
        frame = Frame(buf[pos : pos + length], msgid, message is not None)
        self._account(frame, message)
        frames.append(frame)
        return length

    def _pass_over(self, count: int) -> int:
        self.counters.garbage += count
        return -count

    def _account(self, frame: Frame, message: MessageType | None) -> None:
        """Count a frame of the general path, and let the fast paths know its route."""
        data, seq = frame.data, frame.seq
        sender = data[5:7] if data[0] == MAGIC_V2 else data[3:5]
        source = self.sources.get((sender[0], sender[1]))
        if message is None:
            self.counters.unknown += 1
        elif source is None:
            source = self.sources[sender[0], sender[1]] = SourceCounters(last_seq=seq)
        if source is None:
            return
        if seq == source.last_seq + 1:
            source.last_seq = seq
        else:
            self._jump(sender, source, seq)
        source.frames += 1
        if message is not None and data[0] == MAGIC_V2 and data[5:10] not in self._routes:
            if len(self._routes) >= _MAX_ROUTES:
                self._routes.clear()
            self._routes[data[5:10]] = (residue_of(message.crc_extra), message.id, source)

    def _jump(self, sender: bytes, source: SourceCounters, seq: int) -> None:
        """Move a source's sequence number on, by the rules in the class's docstring."""
        missing = self._missing.get(sender, set())
        if (source.last_seq - seq) & 0xFF <= _LATE:
            if seq in missing:
                missing.remove(seq)
                source.lost -= 1
                self.counters.lost -= 1
            return
        gap = (seq - source.last_seq - 1) & 0xFF
        if gap < 128:
            source.lost += gap
            self.counters.lost += gap
            missing = missing.union(number & 0xFF for number in range(seq - gap, seq))
        # Every wrap to 0 comes by here, so that no number is kept until its next turn.
        self._missing[sender] = {number for number in missing if (seq - number) & 0xFF <= _LATE}
        source.last_seq = seq


_Unpack = Callable[[bytes], tuple[int, int, bytes, int]]
_Layout = tuple[_Unpack, int]


@functools.cache
def _layouts() -> list[_Layout]:
    """For an unsigned MAVLink 2 frame of n bytes: how to unpack its first four bytes, sequence number, bytes 5 to 9 and
    checksum in one call, and what the first four are (magic, length, no flags)."""
    layouts: list[_Layout] = []
    for size in range(_LONGEST_UNSIGNED_V2 + 1):
        payload = max(size - _SHORTEST_V2, 0)  # sizes below the shortest frame are never looked up
        layouts.append((cast(_Unpack, struct.Struct(f"<IB5s{payload}xH").unpack), MAGIC_V2 | payload << 8))
    return layouts


def _is_unfinished(buf: bytes, pos: int) -> bool:
    """Whether ``buf`` ends within the unsigned MAVLink 2 frame that begins at ``pos``, as most reads of a stream do."""
    have = len(buf) - pos
    return buf[pos] == MAGIC_V2 and (have < 3 or (buf[pos + 2] == 0 and have < _SHORTEST_V2 + buf[pos + 1]))
