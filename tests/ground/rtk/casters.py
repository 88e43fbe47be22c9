"""Casters: pygnssutils' own, and those that do what no caster should."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from typing import Any

from pygnssutils.globals import PYGPSMP
from pygnssutils.socket_server import ClientHandler, ClientHandlerTLS, SocketServer

MOUNTPOINT: str = PYGPSMP


class Caster:
    """pygnssutils' caster on a port of its own: ``send`` puts bytes to all its clients."""

    def __init__(self, version: str = "2.0", pem: Path | None = None) -> None:
        self._queue: Queue[bytes] = Queue()
        handler = ClientHandlerTLS if pem else ClientHandler
        more = {"tlspempath": str(pem)} if pem else {}
        self._server = SocketServer(
            None,
            1,
            5,
            self._queue,
            ("127.0.0.1", 0),
            handler,
            ntripversion=version,
            ntripuser="me",
            ntrippassword="secret",
            **more,
        )
        self.port: int = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def clients(self) -> int:
        return int(self._server.connections)

    def send(self, data: bytes) -> None:
        self._queue.put(data)

    def close(self) -> None:
        self._server.shutdown()
        self._server.stop_read_thread()
        self._queue.put(b"")  # its reader looks whether to stop once it has something
        self._server.server_close()


class Hostile:
    """``act(connection)`` is called for each connection, which is closed after it; ``requests`` are what was asked."""

    def __init__(self, act: Callable[[socket.socket], object]) -> None:
        self._act = act
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.requests: list[bytes] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                threading.Thread(target=self._one, args=(connection,), daemon=True).start()

    def _one(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            self.requests.append(connection.recv(4096))
            self._act(connection)

    def close(self) -> None:
        self._listener.close()


STREAM = b"HTTP/1.1 200 OK\r\nContent-Type: gnss/data\r\n\r\n"
CHUNKED = STREAM[:-2] + b"Transfer-Encoding: chunked\r\n\r\n"


def sends(*pieces: bytes, pause: float = 0.02, then: Callable[[socket.socket], object] = lambda c: None) -> Any:
    """What a caster does that sends these, one after the other."""

    def act(connection: socket.socket) -> None:
        for piece in pieces:
            connection.sendall(piece)
            time.sleep(pause)
        then(connection)

    return act


def hangs(connection: socket.socket) -> None:
    connection.settimeout(60.0)
    while connection.recv(4096):
        pass


def repeats(data: bytes) -> Any:
    """Sends it for ever, as fast as it is taken."""

    def act(connection: socket.socket) -> None:
        while True:
            connection.sendall(data)

    return act


@contextlib.contextmanager
def hostile(act: Callable[[socket.socket], object]) -> Iterator[Hostile]:
    one = Hostile(act)
    try:
        yield one
    finally:
        one.close()
