"""TCP servers, for any number of clients: what ArduPilot's serial ports are in simulation."""

from __future__ import annotations

import selectors
import socket
from collections.abc import Callable

from zmav.sim.endpoints.address import Address
from zmav.sim.endpoints.base import ByteLine, Switchboard, Wiring


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


class TcpClient(ByteLine):
    """One connection: what it is answered goes out after each read and each tick."""

    def __init__(
        self,
        connection: socket.socket,
        link: str,
        vehicle: Switchboard,
        wiring: Wiring,
        gone: Callable[[TcpClient], None],
    ) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(connection.detach(), wiring.selector, self._hear, lambda why: None)
        self._vehicle, self._waiting, self._told = vehicle, wiring.waiting, gone
        self._channel = vehicle.open_channel(self, link)

    def put(self, frame: bytes) -> None:
        super().put(frame)
        self._waiting.add(self)

    def _hear(self, data: bytes) -> None:
        self._vehicle.receive(self._channel, data)
        self.flush()

    def close(self) -> None:
        if self._open:
            super().close()
            self._vehicle.close_channel(self._channel)
            self._told(self)
