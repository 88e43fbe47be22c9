"""What every endpoint has: the vehicle behind it, the world that serves it, and a line whose bytes it passes."""

from __future__ import annotations

import os
import selectors
from collections.abc import Callable
from typing import NamedTuple, Protocol

from zmav.sim.protocol.channel import Channel, Outlet

BACKLOG_BYTES = 64 * 1024  # what a client that does not read may leave standing
READ_BYTES = 65536
READS_PER_TURN = 16  # so that a flood on one link does not starve the others


class Switchboard(Protocol):
    """The vehicle behind an endpoint."""

    def open_channel(self, outlet: Outlet, link: str = "") -> Channel: ...

    def close_channel(self, channel: Channel) -> None: ...

    def receive(self, channel: Channel, data: bytes) -> None: ...


class Flushed(Protocol):
    """Holds what is to be sent."""

    def flush(self) -> bool:
        """Send what can be sent now; True where nothing is left to do."""


class Wiring(NamedTuple):
    """What the world does for its endpoints. ``selector`` calls each key's ``data`` when it is ready; everything in
    ``waiting`` is flushed after each tick until it has nothing left.
    """

    selector: selectors.BaseSelector
    waiting: set[Flushed]


class Endpoint(Protocol):
    """A way to reach one vehicle; all methods are called in the world's thread (or before it runs)."""

    url: str
    link: str
    """its kind, which its channels are called by"""

    def clients(self) -> int:
        """How many are known to be at the other end."""

    def close(self) -> None: ...


class ByteLine:
    """An open descriptor, of a socket or a serial device, that never blocks: bytes in by ``heard``, bytes out by
    :meth:`put` and :meth:`flush`. ``gone`` is called once, when the other end has left or the device was unplugged; the
    descriptor is closed then.

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

    def flush(self) -> bool:
        """Send what waits, as far as the line takes it; True where nothing is left to do."""
        if not self._backlog or not self._open:
            return True
        try:
            sent = os.write(self._fd, self._backlog)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError as error:
            self._leave(error.strerror or str(error))
            return True
        del self._backlog[:sent]
        return not self._backlog

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
