"""Sequence numbers for a client that does not get everything a component sent, or gets more.

A ground control station counts what is missing by the gaps in them. Frames that were held back for it must leave no
gap, nor those that were added a repetition; what was lost on the way to us must still show.
"""

from __future__ import annotations

from zmav.mavlink.checksum import crc
from zmav.mavlink.frame import CHECKSUM, MAGIC_V2, SIGNED

OVERTAKEN = 32
"""a frame from so far back at most came late, or twice: it shows no loss"""
_ZEROS = bytes(300)


class Numbering:
    """One component's numbers as one client sees them. ``heard`` is the last one that came, ``sent`` that it got; -1:
    none yet. Not thread-safe.
    """

    __slots__ = ("_heard", "_lost", "_sent")

    def __init__(self, heard: int = -1, sent: int = -1) -> None:
        self._heard, self._sent, self._lost = heard, sent, 0

    def came(self, seq: int) -> None:
        """A frame came, whether the client will get it or not."""
        step = (seq - self._heard) & 0xFF
        if self._heard >= 0 and (step == 0 or step >= 0x100 - OVERTAKEN):
            return
        if self._heard >= 0 and step < 0x80:
            self._lost += step - 1
        self._heard = seq

    def next(self) -> int:
        """The number of the frame that the client gets next."""
        self._sent = (self._sent + 1 + self._lost) & 0xFF
        self._lost = 0
        return self._sent


def sequence_of(data: bytes) -> int:
    return data[4] if data[0] == MAGIC_V2 else data[2]


def renumbered(data: bytes, seq: int) -> bytes:
    """The frame with another sequence number. A signed one stays as it is: nobody but its sender can sign it.

    The checksum is linear in the frame: it changes by the checksum, begun at zero, of what is changed. So the frame
    need not be known, and one that came damaged stays so.
    """
    version2 = data[0] == MAGIC_V2
    at = 4 if version2 else 2
    change = data[at] ^ seq
    if not change or (version2 and data[2] & SIGNED):
        return data
    end = len(data) - CHECKSUM
    # What follows the number: the rest of header and payload, and the message's crc_extra.
    delta = crc(bytes((change,)) + _ZEROS[: end - at], 0)
    checked = (data[end] | data[end + 1] << 8) ^ delta
    return b"".join((data[:at], bytes((seq,)), data[at + 1 : end], checked.to_bytes(CHECKSUM, "little")))
