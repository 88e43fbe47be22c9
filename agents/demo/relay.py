"""The link between two routers of a demo, where it is to be cut in flight: a TCP relay on loopback, without root."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from types import TracebackType

PIECE = 65536
PATIENCE = 5.0
"""s for one end to take what the other sent"""


class Relay:
    """``with Relay(port) as relay``: who connects to loopback's ``relay.port`` reaches ``port`` there; while
    :attr:`cut` is set nothing passes, as out of a radio's reach: nobody is told.
    """

    def __init__(self, port: int) -> None:
        self.cut = threading.Event()
        self._to, self._stop = ("127.0.0.1", port), threading.Event()
        self._door = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._door.getsockname()[1])
        self._other: dict[socket.socket, socket.socket] = {}
        """of each connection its other half"""
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()
        for each in (self._door, *self._other):
            each.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            if self.cut.is_set():
                self._stop.wait(0.05)
                continue
            readable, _, _ = select.select([self._door, *self._other], [], [], 0.05)
            for each in readable:
                if self.cut.is_set():  # meanwhile
                    break
                if each is self._door:
                    self._connect()
                elif each in self._other:
                    self._pass(each)

    def _connect(self) -> None:
        near, _ = self._door.accept()
        try:
            far = socket.create_connection(self._to, PATIENCE)
        except OSError:  # the other end is not there yet: who called tries again
            near.close()
            return
        near.settimeout(PATIENCE)
        self._other[near], self._other[far] = far, near

    def _pass(self, source: socket.socket) -> None:
        with contextlib.suppress(OSError):
            if data := source.recv(PIECE):
                self._other[source].sendall(data)
                return
        for each in (source, self._other[source]):
            del self._other[each]
            each.close()
