"""TCP endpoints: a server that any number of stations connect to."""

from __future__ import annotations

import math
import select
import socket
import time

from ground.gcs.client import Client
from ground.gcs.options import Endpoint
from ground.gcs.places import MOST_CLIENTS, Hub, SocketEndpoint
from zmav.links.base import Backoff
from zmav.links.sockets import DONTWAIT, MAX_READ, READ_WAKE_S, bind_error, resolve, show
from zmav.links.tcp import set_stream_options, shut

WEB = (b"GET ", b"POST ", b"PUT ", b"HEAD ", b"OPTIONS ", b"DELETE ", b"PATCH ")
"""how a browser begins: any web page may have it send something to this computer, and frames within that would fly"""
WENT_AWAY = (BlockingIOError, ConnectionAbortedError, InterruptedError)
"""why no station was let in that came; whatever else it is, such as no descriptor left, may well last"""


class Connection:
    """One station's socket; written by anyone who has something for it, read by the endpoint's thread."""

    stream = True

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self._room = select.poll()
        self._room.register(sock, select.POLLOUT)

    def write(self, data: bytes) -> int:
        try:
            return self.sock.send(data, DONTWAIT)
        except BlockingIOError:
            return 0

    def wait(self, seconds: float) -> None:
        self._room.poll(seconds * 1000)

    def close(self) -> None:
        """Wake who waits; the descriptor is given back by the endpoint's thread, which reads it."""
        shut(self.sock)


class TcpIn(SocketEndpoint):
    """``--tcp``: one thread accepts and reads. A station that stops reading is cut off after a while (by
    TCP_USER_TIMEOUT); until then the newest telemetry waits for it, and nobody waits with it.
    """

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        super().__init__(endpoint, hub)
        self._clients: dict[int, tuple[Client, Connection]] = {}
        self._poll = select.poll()
        self._backoff, self._again = Backoff(), math.inf
        """monotonic s at which it is looked for stations again, where none could be let in"""
        self._full = False
        """that none can be let in was said, and none was since"""

    @property
    def clients(self) -> list[Client]:
        return [client for client, _ in list(self._clients.values())]

    def start(self) -> None:
        family, address = resolve(self.endpoint.host, self.endpoint.port, socket.SOCK_STREAM)[0]
        sock = socket.socket(family, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(address)
            sock.listen(16)
        except OSError as error:
            sock.close()
            raise bind_error(error, address, "tcpin") from error
        sock.setblocking(False)
        self._sock = sock
        self._poll.register(sock, select.POLLIN)
        self._thread.start()

    def close(self) -> None:
        super().close()
        for _, connection in self._clients.values():
            connection.sock.close()

    def _run(self) -> None:
        assert self._sock is not None
        listener = self._sock.fileno()
        while not self._closing.is_set():
            if time.monotonic() >= self._again:
                self._poll.register(listener, select.POLLIN)
                self._again = math.inf
            for fd, _ in self._poll.poll(READ_WAKE_S * 1000):
                if fd == listener:
                    self._accept(self._sock)
                elif fd in self._clients:
                    self._read(fd, *self._clients[fd])

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, address = listener.accept()
        except OSError as error:
            # Who waits goes on waiting: to try at once would keep the thread from who is there.
            if not isinstance(error, WENT_AWAY):
                self._poll.unregister(listener)
                self._again = time.monotonic() + self._backoff.next()
                if not self._full:
                    self._hub.news(f"tcp: no station can be let in: {error.strerror}")
                self._full = True
            return
        self._backoff.reset()
        self._full = False
        if len(self._clients) >= MOST_CLIENTS:
            self.turned_away += 1
            sock.close()
            return
        try:
            set_stream_options(sock)
        except OSError:
            sock.close()
            return
        connection = Connection(sock)
        name = f"tcp {show(address)}"
        client = Client(name, connection, self.endpoint.options, self._hub.dialect, connected=True)
        self._clients[sock.fileno()] = client, connection
        self._poll.register(sock, select.POLLIN)
        self._hub.joined(client)

    def _read(self, fd: int, client: Client, connection: Connection) -> None:
        why = "closed the connection"
        try:
            data = connection.sock.recv(MAX_READ, DONTWAIT)
        except BlockingIOError:
            return
        except OSError as error:
            data, why = b"", error.strerror or str(error)
        if not client.heard and data.startswith(WEB):
            data, why = b"", "it is a browser"
        if not data:
            del self._clients[fd]
            self._poll.unregister(fd)
            self._hub.left(client, why)
            connection.sock.close()
            self._again = 0.0  # its descriptor may be what one that waits needs
            return
        self._take(client, data)
