"""STATUSTEXT in pieces: texts over fifty bytes come as several messages with one ``id`` and rising ``chunk_seq``.

https://mavlink.io/en/messages/common.html#STATUSTEXT: an id of zero is a text of one piece; a NUL within the text
marks the last piece (an empty one follows a text that fills its pieces exactly). Pieces of several texts may come
mixed, twice, out of order, or not at all. Bytes are put together before they are read as UTF-8: a piece may end in the
middle of a character.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from zmav.mavlink.frame import Frame

MSGID = 253
WAIT = 1.0
"""s after the last piece until a text is said with what there is of it"""
MEMORY = 5.0
"""s during which a piece of a finished text is known for a duplicate"""
MOST = 32
"""unfinished texts at a time; beyond it the oldest is said as it is"""
GAP = "[...]"
_PAYLOAD = struct.Struct("<B50sHB")


class Text(NamedTuple):
    """One whole text, or what came of it (``complete`` False, with ``[...]`` for what did not)."""

    compid: int
    severity: int
    """MAV_SEVERITY, 0 (emergency) to 7 (debug)"""
    text: str
    complete: bool
    at: float
    """when its first piece came, in the caller's seconds"""


class _Parts:
    """The pieces of one text so far."""

    def __init__(self, compid: int, severity: int, now: float) -> None:
        self.compid, self.severity, self.first, self.latest = compid, severity, now, now
        self.pieces: dict[int, bytes] = {}
        self.last: int | None = None

    def add(self, seq: int, raw: bytes, now: float) -> None:
        text, ended, _ = raw.partition(b"\0")
        self.pieces[seq] = text
        self.latest = now
        if ended:
            self.last = seq

    @property
    def complete(self) -> bool:
        return self.last is not None and all(seq in self.pieces for seq in range(self.last + 1))

    def text(self) -> Text:
        end = self.last if self.last is not None else max(self.pieces)
        words, missing = b"", False
        for seq in range(end + 1):
            piece = self.pieces.get(seq)
            if piece is not None:
                words += piece
            elif not missing:
                words += GAP.encode()  # once for however many in a row
            missing = piece is None
        if self.last is None:
            words += GAP.encode()
        return Text(self.compid, self.severity, words.decode("utf-8", "replace"), self.complete, self.first)


class TextJoiner:
    """Puts texts together, by sender and id. Not thread-safe; times are any clock's seconds."""

    def __init__(self) -> None:
        self._open: dict[tuple[int, int, int], _Parts] = {}
        self._done: dict[tuple[int, int, int], _Parts] = {}

    def add(self, frame: Frame, now: float) -> list[Text]:
        """The texts that this STATUSTEXT finishes: none, itself, or those that had to make room."""
        severity, raw, number, seq = _PAYLOAD.unpack(frame.payload[: _PAYLOAD.size].ljust(_PAYLOAD.size, b"\0"))
        if number == 0:
            words = raw.partition(b"\0")[0].decode("utf-8", "replace")
            return [Text(frame.compid, severity, words, True, now)]
        place = (frame.sysid, frame.compid, number)
        done = self._done.get(place)
        if done is not None and now - done.latest < MEMORY and done.pieces.get(seq) == raw.partition(b"\0")[0]:
            return []
        said = self._make_room(place)
        parts = self._open.setdefault(place, _Parts(frame.compid, severity, now))
        parts.add(seq, raw, now)
        if parts.complete:
            said.append(self._finish(place))
        return said

    def flush(self, now: float) -> list[Text]:
        """The texts of which nothing more came for :data:`WAIT` seconds."""
        self._done = {place: parts for place, parts in self._done.items() if now - parts.latest < MEMORY}
        late = [place for place, parts in self._open.items() if now - parts.latest >= WAIT]
        return [self._finish(place) for place in late]

    def unfinished(self) -> list[Text]:
        """What there is of texts that still wait for pieces."""
        return [parts.text() for parts in self._open.values()]

    def _make_room(self, place: tuple[int, int, int]) -> list[Text]:
        if place in self._open or len(self._open) < MOST:
            return []
        return [self._finish(min(self._open, key=lambda other: self._open[other].latest))]

    def _finish(self, place: tuple[int, int, int]) -> Text:
        parts = self._done[place] = self._open.pop(place)
        return parts.text()
