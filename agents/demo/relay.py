"""The link between two routers of a demo, where it is to be cut in flight: a UDP relay on loopback, without root."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from types import TracebackType

BUFFER = 65536


class Relay:
    """``with Relay(port) as relay``: what is sent to loopback's ``relay.port`` reaches ``port`` there, and back; while
    :attr:`cut` is set, nothing passes, as out of a radio's reach: nobody is told.
    """

    def __init__(self, port: int) -> None:
        self.cut = threading.Event()
        self._to, self._stop = ("127.0.0.1", port), threading.Event()
        self._near = _socket()
        self.port = int(self._near.getsockname()[1])
        self._far: dict[tuple[str, int], socket.socket] = {}
        self._callers: dict[socket.socket, tuple[str, int]] = {}
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()
        for each in (self._near, *self._far.values()):
            each.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            readable, _, _ = select.select([self._near, *self._far.values()], [], [], 0.1)
            for each in readable:
                with contextlib.suppress(OSError):  # the other end is not there yet, or no more
                    self._pass(each)

    def _pass(self, source: socket.socket) -> None:
        data, sender = source.recvfrom(BUFFER)
        if self.cut.is_set():
            return
        if source is not self._near:
            self._near.sendto(data, self._callers[source])
            return
        if sender not in self._far:
            self._far[sender] = _socket()
            self._callers[self._far[sender]] = sender
        self._far[sender].sendto(data, self._to)


def _socket() -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind(("127.0.0.1", 0))
    return found
