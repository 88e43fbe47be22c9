"""Chunks to pictures, whatever happens to them: lost, twice, out of order, foreign, from a sender that restarted."""

from __future__ import annotations

import functools
import zlib
from typing import NamedTuple

from zmav.errors import BadMessage
from zmav.vision.chunks import PICTURES, Code, Header, parse

UNDER_WAY = 3
"""pictures that are put together at one time"""
GIVE_UP = 1.0
"""s without a chunk after which a picture is given up, and another sender of the same camera is listened to"""
MOST_GAP = 1000
"""pictures missed at a time that are counted; a greater gap counts as so many"""
WRAP = 1 << 32


class Whole(NamedTuple):
    """A picture that came whole."""

    jpeg: bytes
    seq: int
    t: float
    """UTC seconds at the middle of the exposure"""
    width: int
    height: int
    mended: int
    """chunks that were lost and computed"""


class _Part:
    """A picture of which something has come."""

    def __init__(self, head: Header, now: float, code: Code) -> None:
        self._code = code
        self.head = head._replace(place=0)
        self.data: dict[int, bytes] = {}
        self.parity: dict[int, bytes] = {}
        self.bytes = 0
        self.touched = now

    def take(self, head: Header, body: bytes, now: float) -> bool:
        """Whether it was new."""
        spare = head.place >= head.pieces
        store, index = (self.parity, head.place - head.pieces) if spare else (self.data, head.place)
        if index in store:
            return False
        store[index] = body
        self.touched = now
        return True

    def jpeg(self) -> bytes | None:
        """The picture where it can be had by now; empty where what came does not fit together."""
        head = self.head
        if len(self.data) + len(self.parity) < head.pieces:
            return None
        if len(self.data) == head.pieces:
            found = b"".join(self.data[i] for i in range(head.pieces))
        else:
            filled = self._code.mend(head.pieces, head.step, self.data, self.parity)
            if filled is None:
                return None
            found = b"".join(filled)[: head.length]
        return found if zlib.crc32(found) == head.check else b""


class Assembler:
    """Whole pictures in the order of their sequence; newest wins: what is older than one that was given is not given.

    Not more than :data:`UNDER_WAY` pictures of at most a megabyte are held. Nothing that comes raises an error.
    """

    def __init__(self, code: Code = PICTURES) -> None:
        self._code = code
        self.whole = 0
        self.torn = 0
        """pictures of which so much was lost that they could not be mended, all of it included"""
        self.bad = 0
        """chunks that were none, or contradicted others of their picture"""
        self.again = 0
        """chunks that came twice"""
        self.foreign = 0
        """chunks of a second sender of the same camera"""
        self.mended = 0
        """lost chunks that were computed"""
        self.bytes = 0
        """of pictures that were given or given up, all their chunks counted"""
        self.seq: int | None = None
        """of the last picture that came whole"""
        self._sender: int | None = None
        self._heard = 0.0
        self._done: int | None = None  # the last picture that was given or given up
        self._parts: dict[int, _Part] = {}

    def __len__(self) -> int:
        """Pictures of which something is missing yet."""
        return len(self._parts)

    def add(self, chunk: bytes, now: float) -> Whole | None:
        """Take a chunk that came at ``now`` (monotonic seconds); a picture where it has completed one."""
        try:
            head, body = parse(chunk, self._code)
        except BadMessage:
            self.bad += 1
            return None
        if not self._listens_to(head, now):
            self.foreign += 1
            return None
        if self._done is not None and not _later(head.seq, self._done):
            self.bytes += len(chunk)
            return None
        part = self._parts.get(head.seq)
        if part is None:
            part = self._parts[head.seq] = _Part(head, now, self._code)
            self._make_room()
        if part.head.picture != head.picture:
            self.bad += 1
            return None
        if not part.take(head, body, now):
            self.again += 1
            return None
        part.bytes += len(chunk)
        return self._completed(part)

    def expire(self, now: float) -> None:
        """Give up pictures of which nothing came for :data:`GIVE_UP` seconds."""
        for seq in [seq for seq, part in self._parts.items() if now - part.touched > GIVE_UP]:
            if seq in self._parts:
                self._settle(seq, whole=False)

    def _listens_to(self, head: Header, now: float) -> bool:
        if self._sender != head.sender:
            if self._sender is not None and now - self._heard <= GIVE_UP:
                return False
            self.torn += len(self._parts)  # what a sender that has gone left behind
            self._parts.clear()
            self._sender, self._done, self.seq = head.sender, None, None
        self._heard = now
        return True

    def _make_room(self) -> None:
        while len(self._parts) > UNDER_WAY:
            oldest = functools.reduce(lambda one, other: other if _later(one, other) else one, self._parts)
            self._settle(oldest, whole=False)

    def _completed(self, part: _Part) -> Whole | None:
        seq = part.head.seq
        if seq not in self._parts:  # it was the oldest when room was made
            return None
        jpeg = part.jpeg()
        if jpeg is None:
            return None
        self._settle(seq, whole=bool(jpeg))
        if not jpeg:
            self.bad += 1
            return None
        head, mended = part.head, part.head.pieces - len(part.data)
        self.mended += mended
        return Whole(jpeg, seq, head.t, head.width, head.height, mended)

    def _settle(self, seq: int, *, whole: bool) -> None:
        """A picture is given or given up, and with it all before it."""
        missed = 0 if self._done is None else min((seq - self._done - 1) % WRAP, MOST_GAP)
        if self._done is None:
            missed = sum(1 for each in self._parts if _later(seq, each))
        self.torn += missed + (not whole)
        self.whole += whole
        if whole:
            self.seq = seq
        self._done = seq
        for each in [each for each in self._parts if not _later(each, seq)]:
            self.bytes += self._parts.pop(each).bytes


def _later(a: int, b: int) -> bool:
    """Whether sequence ``a`` comes after ``b``, also where the number began again at zero (RFC 1982)."""
    return 0 < (a - b) % WRAP < WRAP // 2
