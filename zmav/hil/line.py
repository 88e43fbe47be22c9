"""A byte line to an autopilot: an open descriptor (socket or serial device) that never blocks."""

from __future__ import annotations

import os
import selectors
from collections.abc import Callable

READ_BYTES = 65536
READS_PER_TURN = 16
BACKLOG_BYTES = 64 * 1024  # what an autopilot that does not read may leave standing


class HilLine:
    """Bytes in by ``heard``, bytes out by :meth:`put` and :meth:`flush`. ``gone`` is called once, when the other end
    has left or the device was unplugged; the descriptor is closed then.

    It is taken out of ``selector`` when it closes; who made the descriptor by a socket object must have detached it.
    """

    def __init__(
        self,
        descriptor: int,
        selector: selectors.BaseSelector,
        heard: Callable[[bytes], None],
        gone: Callable[[str], None],
    ) -> None:
        self._fd = descriptor
        self._selector = selector
        self._heard = heard
        self._gone = gone
        self._backlog = bytearray()
        self._open = True
        os.set_blocking(descriptor, False)
        selector.register(descriptor, selectors.EVENT_READ, self._read)

    def room(self) -> int:
        """Bytes that may wait to be sent."""
        return BACKLOG_BYTES - len(self._backlog) if self._open else 0

    def put(self, data: bytes) -> None:
        self._backlog += data

    def flush(self) -> None:
        """Send what waits, as far as the line takes it."""
        if not self._backlog or not self._open:
            return
        try:
            sent = os.write(self._fd, self._backlog)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._leave(error.strerror or str(error))
            return
        del self._backlog[:sent]

    def _read(self) -> None:
        for _ in range(READS_PER_TURN):
            if not self._open:
                return
            try:
                data = os.read(self._fd, READ_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                self._leave(error.strerror or str(error))
                return
            if not data:
                self._leave("closed at the other end")
                return
            self._heard(data)
            if len(data) < READ_BYTES:
                return

    def _leave(self, why: str) -> None:
        if self._open:
            self.close()
            self._gone(why)

    def close(self) -> None:
        if self._open:
            self._open = False
            self._selector.unregister(self._fd)
            os.close(self._fd)
