"""Frames: find MAVLink 1 and 2 frames in a stream of bytes, check them once, count what was wrong and what was lost.

Packet formats: https://mavlink.io/en/guide/serialization.html#mavlink2_packet_format
"""

from __future__ import annotations

import msgspec
from fastcrc import crc16

from zmav.errors import BadMessage
from zmav.mavlink.dialect import Dialect, MessageType

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
SIGNED = 0x01
"""The one incompatibility flag that is understood: 13 bytes of signature follow the checksum."""

HEADER_V1 = 6
HEADER_V2 = 10
_CRC = 2
_SIGNATURE = 13

_crc = crc16.mcrf4xx


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One MAVLink frame: ``data`` from its magic byte to the last byte of checksum or signature, as it came.

    ``verified`` is False for a message the dialect lacks: its checksum needs the dialect's crc_extra.
    """

    data: bytes
    msgid: int
    verified: bool

    @property
    def version(self) -> int:
        """1 or 2."""
        return 2 if self.data[0] == MAGIC_V2 else 1

    @property
    def sysid(self) -> int:
        return self.data[5] if self.data[0] == MAGIC_V2 else self.data[3]

    @property
    def compid(self) -> int:
        return self.data[6] if self.data[0] == MAGIC_V2 else self.data[4]

    @property
    def seq(self) -> int:
        return self.data[4] if self.data[0] == MAGIC_V2 else self.data[2]

    @property
    def payload(self) -> bytes:
        """The payload as on the wire: MAVLink 2 leaves out zeros at its end."""
        start = HEADER_V2 if self.data[0] == MAGIC_V2 else HEADER_V1
        return self.data[start : start + self.data[1]]

    @property
    def incompat_flags(self) -> int:
        return self.data[2] if self.data[0] == MAGIC_V2 else 0

    @property
    def signed(self) -> bool:
        """The frame carries a signature (which is not checked here)."""
        return bool(self.incompat_flags & SIGNED)


class SplitCounters(msgspec.Struct):
    """What a splitter has seen since it was made."""

    bytes: int = 0
    frames: int = 0
    bad_crc: int = 0
    bad_length: int = 0
    bad_flags: int = 0
    unknown: int = 0
    garbage: int = 0
    lost: int = 0


class SourceCounters(msgspec.Struct):
    """What one (system, component) has sent."""

    frames: int = 0
    lost: int = 0
    last_seq: int = -1


class Splitter:
    """Cuts a stream of bytes into frames."""

    def __init__(self, dialect: Dialect) -> None:
        self.counters = SplitCounters()
        self.sources: dict[tuple[int, int], SourceCounters] = {}
        self._known = {m.id: (bytes((m.crc_extra,)), m.base_length) for m in dialect.by_id.values()}
        self._partial = b""
        self._in_sync = True

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes of the stream; returns the frames that are now whole, in order."""
        counters = self.counters
        counters.bytes += len(data)
        buf = self._partial + data if self._partial else data
        pos, size = 0, len(buf)
        frames: list[Frame] = []
        while pos < size:
            taken = self._next(buf, pos, size, frames)
            if taken == 0:
                break
            if taken < 0:
                counters.garbage -= taken
                self._in_sync = False
            pos += abs(taken)
        self._partial = buf[pos:]
        counters.frames += len(frames)
        return frames

    def reset(self) -> None:
        """Forget a partial frame: the link was reopened. Counters stay."""
        self.counters.garbage += len(self._partial)
        self._partial = b""
        self._in_sync = True

    def _next(self, buf: bytes, pos: int, size: int, frames: list[Frame]) -> int:
        """Bytes of the frame found at ``pos``; minus the number of bytes to skip; 0 where more bytes are needed."""
        counters = self.counters
        magic = buf[pos]
        if magic != MAGIC_V2 and magic != MAGIC_V1:
            following = [p for p in (buf.find(b"\xfd", pos), buf.find(b"\xfe", pos)) if p >= 0]
            return pos - min(following, default=size)
        header = HEADER_V2 if magic == MAGIC_V2 else HEADER_V1
        if size - pos < header:
            if header == HEADER_V2 and size - pos > 2 and buf[pos + 2] & ~SIGNED:
                counters.bad_flags += 1
                return -1
            return 0
        length = header + buf[pos + 1] + _CRC
        if magic == MAGIC_V2:
            flags = buf[pos + 2]
            if flags & ~SIGNED:
                counters.bad_flags += 1
                return -1
            if flags:
                length += _SIGNATURE
            msgid = int.from_bytes(buf[pos + 7 : pos + 10], "little")
        else:
            msgid = buf[pos + 5]
        known = self._known.get(msgid)
        if known is None and not self._in_sync:
            return -1
        if known is not None and magic == MAGIC_V1 and buf[pos + 1] < known[1]:
            counters.bad_length += 1
            return -1
        if size - pos < length:
            return 0
        end = pos + header + buf[pos + 1]
        if known is not None and _crc(buf[pos + 1 : end] + known[0]) != buf[end] | buf[end + 1] << 8:
            counters.bad_crc += 1
            return -1
        frame = Frame(buf[pos : pos + length], msgid, known is not None)
        counters.unknown += known is None
        self._in_sync = True
        self._count(frame)
        frames.append(frame)
        return length

    def _count(self, frame: Frame) -> None:
        key = (frame.sysid, frame.compid)
        source = self.sources.get(key)
        if source is None:
            if not frame.verified:
                return
            source = self.sources[key] = SourceCounters(last_seq=(frame.seq - 1) & 0xFF)
        gap = (frame.seq - source.last_seq - 1) & 0xFF
        if 0 < gap < 128:
            source.lost += gap
            self.counters.lost += gap
        source.last_seq = frame.seq
        source.frames += 1


def parse_frame(data: bytes, dialect: Dialect) -> Frame:
    """The one frame that ``data`` is, whole and valid; raises :class:`BadMessage` saying why it is not."""
    splitter = Splitter(dialect)
    frames = splitter.feed(data)
    if len(frames) == 1 and len(frames[0].data) == len(data):
        return frames[0]
    raise BadMessage("not one whole MAVLink frame", field="frame", value=data.hex(), expected="one whole MAVLink frame")


def build_frame(message: MessageType, payload: bytes, sysid: int, compid: int, seq: int, version: int = 2) -> bytes:
    """An unsigned frame around a payload; MAVLink 2 leaves out the zeros at the payload's end, but for one byte."""
    if version == 1:
        head = bytes((MAGIC_V1, len(payload), seq, sysid, compid, message.id))
    else:
        payload = payload.rstrip(b"\0") or payload[:1]
        head = bytes((MAGIC_V2, len(payload), 0, 0, seq, sysid, compid)) + message.id.to_bytes(3, "little")
    body = head + payload
    return body + _crc(body[1:] + bytes((message.crc_extra,))).to_bytes(2, "little")
