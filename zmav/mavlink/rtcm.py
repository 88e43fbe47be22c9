"""GPS_RTCM_DATA: RTCM messages cut for an autopilot's link, and put together again.

A frame holds 180 bytes. Flags: bit 0, it is one of several fragments; bits 1 and 2, which; bits 3 to 7, of which
sequence. Four fragments are the most, and one that is not full is the last, so that two full ones are followed by an
empty one (https://mavlink.io/en/messages/common.html#GPS_RTCM_DATA). What is longer goes as two sequences: receivers
read a stream of bytes, to which autopilots add each sequence when it is whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

PIECE, MOST_PIECES, SEQUENCES = 180, 4, 32
WHOLE = PIECE * MOST_PIECES


def cut(data: bytes, sequence: int) -> Iterator[tuple[int, bytes]]:
    """Flags and bytes of each frame; the sequence is counted on by the caller, by :func:`sequences`."""
    for number, at in enumerate(range(0, len(data), WHOLE)):
        part = data[at : at + WHOLE]
        head = (sequence + number) % SEQUENCES << 3
        if len(part) <= PIECE:
            yield head, part
            continue
        for piece in range(min(len(part) // PIECE + 1, MOST_PIECES)):
            yield head | piece << 1 | 1, part[piece * PIECE : (piece + 1) * PIECE]


def sequences(data: bytes) -> int:
    """How many sequences ``data`` takes."""
    return -(-len(data) // WHOLE)


def fields(flags: int, piece: bytes) -> dict[str, Any]:
    """The message's fields."""
    return {"flags": flags, "len": len(piece), "data": piece.ljust(PIECE, b"\0")}


class Joiner:
    """Puts fragments of one sender together, as an autopilot does: it keeps four at most."""

    def __init__(self) -> None:
        self._sequence = -1
        self._pieces: dict[int, bytes] = {}

    def add(self, flags: int, length: int, data: bytes) -> bytes:
        """A frame; the bytes of its sequence where that is whole by now, else none."""
        piece = bytes(data[: min(length, PIECE)])
        if not flags & 1:
            return piece
        sequence, number = flags >> 3, flags >> 1 & 3
        if sequence != self._sequence or number in self._pieces:
            self._sequence, self._pieces = sequence, {}
        self._pieces[number] = piece
        last = next((n for n, each in self._pieces.items() if len(each) < PIECE), MOST_PIECES - 1)
        if any(n not in self._pieces for n in range(last + 1)):
            return b""
        whole = b"".join(self._pieces[n] for n in range(last + 1))
        self._sequence, self._pieces = -1, {}
        return whole
