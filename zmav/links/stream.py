"""Sending on a byte stream (TCP, serial) without blocking and without ever cutting a frame in two."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Callable

from zmav.links.base import Link

WriteSome = Callable[[bytes], int]  # bytes taken, 0 when the transport is full; raises OSError when it is gone


class Outbox:
    """What a stream has not taken yet: the rest of a frame it took a part of, and whole frames after it.

    A frame is accepted whole or refused whole; an accepted one is always completed before anything else is written,
    so that the stream stays framed. Not thread-safe: the link's lock guards it.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._rest = b""

    def __len__(self) -> int:
        return len(self._rest)

    def send(self, write: WriteSome, frame: bytes) -> bool:
        """Write or queue a frame; False when more than ``limit`` bytes would then wait."""
        if self._rest:
            self.flush(write)
        if self._rest:
            if len(self._rest) + len(frame) > self.limit:
                return False
            self._rest += frame
            return True
        self._rest = frame[write(frame) :]
        return True

    def flush(self, write: WriteSome) -> None:
        if self._rest:
            self._rest = self._rest[write(self._rest) :]

    def clear(self) -> None:
        """Forget everything: the next connection must not begin in the middle of a frame."""
        self._rest = b""


class StreamLink(Link):
    """A link over a byte stream; a transport says how to write some bytes without blocking."""

    def __init__(self, url: str, outbox_limit: int) -> None:
        super().__init__(url)
        self._outbox = Outbox(outbox_limit)

    @abstractmethod
    def _write_some(self, data: bytes) -> int:
        """Bytes taken, 0 when full; raises OSError or LinkDown when nobody is connected."""

    def _write(self, data: bytes) -> int:
        if self._outbox.send(self._write_some, data):
            return len(data)
        self._note("the other end does not read: the output buffer is full")
        return 0

    def _flush(self) -> None:
        """Write on what had to wait; the reader calls it between reads. Errors are left for the read to meet."""
        if self._outbox:
            with self._tx_lock, contextlib.suppress(OSError):
                self._outbox.flush(self._write_some)
