"""One MAVLink frame: what it says in its header, how it is checked, and how it is built.

Packet formats: https://mavlink.io/en/guide/serialization.html#mavlink2_packet_format
"""

from __future__ import annotations

import msgspec

from zmav.errors import BadMessage
from zmav.mavlink.checksum import checksum
from zmav.mavlink.dialect import Dialect, MessageType

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
SIGNED = 0x01
"""The one incompatibility flag that is understood: 13 bytes of signature follow the checksum."""

HEADER_V1 = 6
HEADER_V2 = 10
CHECKSUM = 2
SIGNATURE = 13


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One MAVLink frame: ``data`` from its magic byte to the last byte of checksum or signature, as it came.

    ``verified`` is False for a message the dialect lacks: the checksum needs the dialect's crc_extra.
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


def parse_frame(data: bytes, dialect: Dialect) -> Frame:
    """The one frame that ``data`` is, whole and valid; raises :class:`BadMessage` saying why it is not.

    As in a stream, a message the dialect lacks is taken on trust (``verified`` False).
    """
    version = {MAGIC_V1: 1, MAGIC_V2: 2}.get(data[0]) if data else None
    if version is None:
        raise _no_frame(data, "it does not begin with 0xFD or 0xFE")
    header = HEADER_V2 if version == 2 else HEADER_V1
    if len(data) < header + CHECKSUM:
        raise _no_frame(data, f"{len(data)} bytes are too few for a MAVLink {version} frame")
    flags = data[2] if version == 2 else 0
    if flags & ~SIGNED:
        raise _no_frame(data, f"incompatibility flags 0x{flags:02x} are not understood")
    end = header + data[1]
    length = end + CHECKSUM + (SIGNATURE if flags else 0)
    if len(data) != length:
        raise _no_frame(data, f"it has {len(data)} bytes, but {length} by its header")
    msgid = int.from_bytes(data[7:10], "little") if version == 2 else data[5]
    message = dialect.by_id.get(msgid)
    if message is not None:
        if version == 1 and data[1] < message.base_length:
            raise _no_frame(data, f"{message.name} has {message.base_length} payload bytes in MAVLink 1, not {data[1]}")
        expected = checksum(data[1:end], message.crc_extra)
        found = int.from_bytes(data[end : end + CHECKSUM], "little")
        if found != expected:
            raise _no_frame(data, f"the checksum of {message.name} is 0x{found:04x}, but should be 0x{expected:04x}")
    return Frame(data, msgid, message is not None)


def _no_frame(data: bytes, reason: str) -> BadMessage:
    return BadMessage(
        f"not a MAVLink frame: {reason}",
        field="frame",
        value=bytes(data[:300]).hex(),
        expected="one whole MAVLink 1 or 2 frame",
        reason=reason,
    )


def build_frame(message: MessageType, payload: bytes, sysid: int, compid: int, seq: int, version: int = 2) -> bytes:
    """An unsigned frame around a payload; MAVLink 2 leaves out the zeros at the payload's end, but for one byte."""
    if version == 1:
        body = bytes((len(payload), seq, sysid, compid, message.id)) + payload
        magic = MAGIC_V1
    else:
        payload = payload.rstrip(b"\0") or payload[:1]
        body = bytes((len(payload), 0, 0, seq, sysid, compid)) + message.id.to_bytes(3, "little") + payload
        magic = MAGIC_V2
    return bytes((magic,)) + body + checksum(body, message.crc_extra).to_bytes(CHECKSUM, "little")
