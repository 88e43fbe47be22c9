"""MAVLink's checksum: CRC-16/MCRF4XX over header (without the magic byte), payload, and the message's crc_extra.

https://mavlink.io/en/guide/serialization.html#checksum
"""

from __future__ import annotations

import functools
from array import array

from fastcrc import crc16

crc = crc16.mcrf4xx

BEFORE_MAGIC_V2 = 0x3085
"""The register that the magic byte 0xFD turns into the start value 0xFFFF, so that whole frames can be summed up."""


def checksum(body: bytes, crc_extra: int) -> int:
    """The checksum of a frame whose bytes between magic and checksum are ``body``."""
    return crc(body + bytes((crc_extra,)))


@functools.cache
def residues() -> array[int]:
    """What is left in the register after summing up a whole good frame, by the checksum the frame ends with.

    Summing up a frame with its checksum, in one call and without cutting anything out of it, is the fastest check there
    is in Python; but crc_extra is not in the frame, so that the register does not end at zero. Let S be the register
    after the payload; the sender made the checksum C by feeding it crc_extra, the receiver ends at R by feeding it C.
    With crc_extra 0, S and hence R follow from C alone: they are this table. The register is linear in what it is fed,
    so that any other crc_extra only adds a constant, :func:`residue_of`. A frame is good where

        crc(frame, BEFORE_MAGIC_V2) == residues()[C] ^ residue_of(crc_extra)
    """
    table = array("H", bytes(2 << 16))
    for register in range(1 << 16):
        made = crc(b"\0", register)
        table[made] = crc(made.to_bytes(2, "little"), register)
    return table


def residue_of(crc_extra: int) -> int:
    """What a message's crc_extra adds to the entries of :func:`residues`."""
    return crc(b"\0\0", crc_extra)
