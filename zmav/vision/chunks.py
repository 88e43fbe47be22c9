"""A picture on the wire: a JPEG in chunks of at most 1.1 kB, each of which says where it belongs.

Best-effort lanes lose chunks and mix their order, so each has the whole header (36 bytes, big-endian)::

    2s  magic "zJ"          B  version, 1            B  parity chunks of this picture
    I   the sender: a number it draws at its start   I  sequence of the picture
    H   place of the chunk  H  chunks of data        I  length of the JPEG      I  its CRC-32
    H   width   H  height   d  UTC seconds at the middle of the exposure

Chunks 0 to count - 1 hold ceil(length / count) bytes each, the last one the rest; those from count on are parity
(:mod:`zmav.vision.parity`). Access units of video go the same way, with "zV" and another code. No Zenoh and no OpenCV
here.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from zmav.errors import BadInput, BadMessage
from zmav.vision import erasure, parity

MOST_CHUNK = 1100
"""bytes of a chunk with its header"""
MOST_JPEG = 1_000_000
"""bytes of a picture"""
VERSION = 1
HEADER = struct.Struct(">2sBBIIHHIIHHd")
ROOM = MOST_CHUNK - HEADER.size
LATEST_T = 1e11
"""UTC seconds that nobody's clock shows"""


class Code(NamedTuple):
    """What is cut into chunks, and how lost ones are mended."""

    magic: bytes
    encode: Callable[[Sequence[bytes], int, int], list[bytes]]
    mend: Callable[[int, int, Mapping[int, bytes], Mapping[int, bytes]], list[bytes] | None]


PICTURES = Code(b"zJ", parity.encode, parity.mend)
VIDEO = Code(b"zV", erasure.encode, erasure.mend)


class Header(NamedTuple):
    """What a chunk says of itself and its picture."""

    parity: int
    sender: int
    seq: int
    place: int
    pieces: int
    """chunks of data; parity ones come on top"""
    length: int
    check: int
    width: int
    height: int
    t: float

    @property
    def step(self) -> int:
        """Bytes in each chunk but the last."""
        return -(-self.length // self.pieces)

    @property
    def picture(self) -> tuple[object, ...]:
        """All that is the same in every chunk of a picture."""
        return self._replace(place=0)

    def size(self) -> int:
        """Bytes that the chunk holds behind its header."""
        return self.length - self.step * (self.pieces - 1) if self.place == self.pieces - 1 else self.step


def count_of(length: int) -> int:
    """Chunks of data that a JPEG of ``length`` bytes becomes."""
    return -(-length // ROOM)


def split(
    jpeg: bytes, *, sender: int, seq: int, t: float, size: tuple[int, int], spare: int = 0, code: Code = PICTURES
) -> list[bytes]:
    """The chunks of a picture, data first, then ``spare`` of parity; ``size`` is width and height in pixels.

    Raises :class:`BadInput` for an empty or an oversized picture, or values that have no place in the header.
    """
    if not 0 < len(jpeg) <= MOST_JPEG:
        text = f"a JPEG of {len(jpeg)} bytes cannot be sent: expected 1 to {MOST_JPEG}"
        raise BadInput(text, field="jpeg", value=len(jpeg), expected=f"1 to {MOST_JPEG} bytes")
    count = count_of(len(jpeg))
    step = -(-len(jpeg) // count)
    count = -(-len(jpeg) // step)  # the last is never empty
    head = Header(spare, sender, seq, 0, count, len(jpeg), zlib.crc32(jpeg), *size, t)
    data = [jpeg[i : i + step] for i in range(0, len(jpeg), step)]
    try:
        return [
            HEADER.pack(code.magic, VERSION, *head._replace(place=i)) + chunk
            for i, chunk in enumerate(data + code.encode(data, step, spare))
        ]
    except struct.error as e:
        raise BadInput(f"a picture's header cannot hold {head}: {e}", field="header", value=str(head)) from e


def parse(data: bytes, code: Code = PICTURES) -> tuple[Header, bytes]:
    """A chunk's header and what it holds; raises :class:`BadMessage` for what is not a chunk."""
    if not HEADER.size < len(data) <= MOST_CHUNK:
        raise _bad("length", len(data), f"{HEADER.size + 1} to {MOST_CHUNK} bytes")
    magic, version, *rest = HEADER.unpack_from(data)
    head = Header(*rest)
    length, t = head.length, head.t
    if (magic, version) != (code.magic, VERSION):
        raise _bad("magic", (magic, version), f"{code.magic!r}, version {VERSION}")
    if not 0 < length <= MOST_JPEG:
        raise _bad("length of the JPEG", length, f"1 to {MOST_JPEG}")
    fits = 0 < head.pieces <= length and head.place < head.pieces + head.parity
    if not fits or head.step > ROOM or head.step * (head.pieces - 1) >= length:
        raise _bad("index, count", (head.place, head.pieces), f"the place of a chunk in {length} bytes")
    if not (math.isfinite(t) and 0.0 <= t < LATEST_T) or not head.width or not head.height:
        raise _bad("t, width, height", (t, head.width, head.height), "UTC seconds and a size")
    if len(data) - HEADER.size != head.size():
        raise _bad("length", len(data), f"{HEADER.size + head.size()} bytes")
    return head, data[HEADER.size :]


def _bad(field: str, value: object, expected: str) -> BadMessage:
    return BadMessage.wrong(field, value, expected, f"a chunk's {field} is {value!r}")
