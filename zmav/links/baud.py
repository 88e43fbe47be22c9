"""Is this MAVLink? A light check, to find a serial port's baud rate by listening.

Either one HEARTBEAT whose checksum is right, or several frames in a row, each beginning where the one before it ends.
Frames: https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

from fastcrc import crc16

CANDIDATES = (115200, 57600, 921600, 460800, 230400, 38400, 1500000, 500000, 1000000, 2000000, 3000000, 19200, 9600)
CHAIN = 3  # so many whole frames in a row, and the beginning of the next if there is more
NOISE = 1200  # bytes without MAVLink that settle it: at least four times the longest frame (280)

_V1, _V2 = 0xFE, 0xFD
_HEARTBEAT_ID, _HEARTBEAT_EXTRA, _HEARTBEAT_LENGTH = 0, 50, 9
_SIGNED = 0x01


class MavlinkDetector:
    """Listens to a piece of a stream: ``hear`` says True (MAVLink), False (enough heard: noise) or None (not yet)."""

    def __init__(self) -> None:
        self.heard = bytearray()  # so that the frames already heard are not lost

    def hear(self, data: bytes) -> bool | None:
        self.heard += data
        if is_mavlink(self.heard):
            return True
        if len(self.heard) < NOISE:
            return None
        return False


def is_mavlink(data: bytes | bytearray) -> bool:
    """Whether a true HEARTBEAT, or ``CHAIN`` frames in a row, stand anywhere in ``data``."""
    return any(data[at] in (_V1, _V2) and (_is_heartbeat(data, at) or _chains(data, at)) for at in range(len(data)))


def _frame_length(data: bytes | bytearray, at: int) -> int:
    """Length of the frame that begins at ``at``; 0 when none does, -1 when its header is not whole."""
    if data[at] == _V1:
        return 8 + data[at + 1] if at + 1 < len(data) else -1
    if data[at] != _V2:
        return 0
    if at + 2 >= len(data):
        return -1
    flags = data[at + 2]
    if flags & ~_SIGNED:
        return 0
    return 12 + data[at + 1] + (13 if flags & _SIGNED else 0)


def _chains(data: bytes | bytearray, at: int) -> bool:
    """``CHAIN`` whole frames of one version follow one another, and the sequence of each source is unbroken."""
    version = data[at]
    last_seq: dict[bytes, int] = {}
    for _ in range(CHAIN):
        length = _frame_length(data, at) if at < len(data) else -1
        if length <= 0 or at + length > len(data) or data[at] != version:
            return False
        head = at + (2 if version == _V1 else 4)
        seq, source = data[head], bytes(data[head + 1 : head + 3])
        if source[0] == 0 or (source in last_seq and seq != (last_seq[source] + 1) % 256):
            return False
        last_seq[source] = seq
        at += length
    # Different sources need not agree in anything; some source must have been met twice.
    return len(last_seq) < CHAIN and (at >= len(data) or data[at] == version)


def _is_heartbeat(data: bytes | bytearray, at: int) -> bool:
    header = 6 if data[at] == _V1 else 10
    msgid = data[at + 5 : at + 6] if data[at] == _V1 else data[at + 7 : at + 10]
    end = at + header + _HEARTBEAT_LENGTH
    if end + 2 > len(data) or data[at + 1] != _HEARTBEAT_LENGTH or any(msgid):
        return False
    body = bytes(data[at + 1 : end]) + bytes([_HEARTBEAT_EXTRA])
    return crc16.mcrf4xx(body) == int.from_bytes(data[end : end + 2], "little")
