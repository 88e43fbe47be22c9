"""TCP servers, for any number of clients: what ArduPilot's serial ports are in simulation."""

from __future__ import annotations

import selectors
import socket
from collections.abc import Callable

from zmav.sim.endpoints.address import Address
from zmav.sim.endpoints.base import BACKLOG_BYTES, READ_BYTES, READS_PER_TURN, Switchboard, Wiring


class TcpServer:
    """Listens; every client is a channel of its own."""

    def __init__(self, address: Address, vehicle: Switchboard, wiring: Wiring) -> None:
        self.link = address.kind
        self._vehicle = vehicle
        self._wiring = wiring
        self._clients: list[TcpClient] = []
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.create_server((address.host, address.port), family=family, backlog=16)
        self._socket.setblocking(False)
        self.port = int(self._socket.getsockname()[1])
        self.url = f"tcp:{address.host}:{self.port}"
        wiring.selector.register(self._socket, selectors.EVENT_READ, self._accept)

    def clients(self) -> int:
        return len(self._clients)

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except OSError:
            return  # it left before it was let in
        self._clients.append(TcpClient(connection, self.link, self._vehicle, self._wiring, self._clients.remove))

    def close(self) -> None:
        for client in list(self._clients):
            client.close()
        self._wiring.selector.unregister(self._socket)
        self._socket.close()


class TcpClient:
    """One connection."""

    def __init__(
        self,
        connection: socket.socket,
        link: str,
        vehicle: Switchboard,
        wiring: Wiring,
        gone: Callable[[TcpClient], None],
    ) -> None:
        self._socket = connection
        self._vehicle = vehicle
        self._wiring = wiring
        self._gone = gone
        self._backlog = bytearray()
        self._open = True
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        wiring.selector.register(connection, selectors.EVENT_READ, self._read)
        self._channel = vehicle.open_channel(self, link)

    def room(self) -> int:
        return BACKLOG_BYTES - len(self._backlog)

    def put(self, frame: bytes) -> None:
        self._backlog += frame
        self._wiring.waiting.add(self)

    def _read(self) -> None:
        for _ in range(READS_PER_TURN):
            try:
                data = self._socket.recv(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                self.close()
                return
            if not data:
                self.close()
                return
            self._vehicle.receive(self._channel, data)
        self.flush()

    def flush(self) -> bool:
        if not self._backlog or not self._open:
            return True
        try:
            sent = self._socket.send(self._backlog)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self.close()
            return True
        del self._backlog[:sent]
        return not self._backlog

    def close(self) -> None:
        if not self._open:
            return
        self._open = False
        self._wiring.selector.unregister(self._socket)
        self._socket.close()
        self._vehicle.close_channel(self._channel)
        self._gone(self)
