"""What goes with each message, request and answer: 33 bytes, and not one more or less.

Little endian: a sequence number (int64), nanoseconds since the epoch (int64), 16 (the length of what follows), and the
GID of who says it. Another implementation has ended its process over a malformed one, so what we write is always this,
and what we read may be anything.
"""

from __future__ import annotations

import struct
import time
from typing import NamedTuple

from zmav.errors import BadInput

_FORM = struct.Struct("<qqB16s")
SIZE = _FORM.size
GID = 16
"""bytes of a GID"""


class Attachment(NamedTuple):
    sequence: int
    stamp_ns: int
    gid: bytes

    def encode(self) -> bytes:
        if len(self.gid) != GID:
            raise ValueError(f"a GID has {GID} bytes, not {len(self.gid)}")
        return _FORM.pack(self.sequence, self.stamp_ns, GID, self.gid)


def write(sequence: int, gid: bytes) -> bytes:
    """The attachment of what is said now."""
    return Attachment(sequence, time.time_ns(), gid).encode()


def read(data: bytes | None) -> Attachment:
    """Raises :class:`BadInput` for anything else than 33 bytes of that form."""
    if data is None or len(data) != SIZE:
        have = "none" if data is None else f"{len(data)} bytes"
        raise BadInput(
            f"an attachment has {SIZE} bytes; there are {have}", field="attachment", expected=f"{SIZE} bytes"
        )
    sequence, stamp_ns, length, gid = _FORM.unpack(data)
    if length != GID:
        text = f"a GID has {GID} bytes; the attachment says {length}"
        raise BadInput(text, field="attachment", value=length, expected=f"{GID}")
    return Attachment(sequence, stamp_ns, gid)
