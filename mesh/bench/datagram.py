"""What a measuring datagram holds: a tag of its run, its number, when it was sent, and filling.

    offset  size
    0       2     0x5A42
    2       2     0
    4       4     tag of the run
    8       4     number, from 0
    12      8     the sender's monotonic clock in ns
    20      ...   filling, random so that no compression flatters the link

Little-endian. All of it is payload: what Zenoh, IP and the radio add comes on top.
"""

from __future__ import annotations

import struct
import zlib

_HEAD = struct.Struct("<HHIIq")
MAGIC = 0x5A42
LEAST = _HEAD.size
MOST = 65_000
NUMBERS = 1 << 32

head = _HEAD.pack


def tag_of(run: str) -> int:
    return zlib.crc32(run.encode())


def read(data: bytes, tag: int) -> tuple[int, int] | None:
    """Its number and when it was sent; None where it is none of this run's."""
    if len(data) < LEAST:
        return None
    magic, _, its_tag, number, sent = _HEAD.unpack_from(data)
    return (number, sent) if magic == MAGIC and its_tag == tag else None
