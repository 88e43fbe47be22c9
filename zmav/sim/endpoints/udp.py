"""UDP, one frame a datagram: ArduPilot's way, to one address; PX4's, to who spoke first; and a listener, to who spoke
last.
"""

from __future__ import annotations

import selectors
import socket
from typing import Any

from zmav.links.sockets import is_loopback
from zmav.sim.endpoints.address import Address
from zmav.sim.endpoints.base import BACKLOG_BYTES, READ_BYTES, READS_PER_TURN, Switchboard, Wiring


class UdpSender:
    """Sends to one address from one local port; takes what anybody sends to that port."""

    def __init__(self, address: Address, vehicle: Switchboard, wiring: Wiring) -> None:
        self.link = address.kind
        self._vehicle = vehicle
        self._wiring = wiring
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._to: Any = self._bind(address, family)
        except BaseException:
            self._socket.close()
            raise
        self.local_port = int(self._socket.getsockname()[1])
        self.url = self._name(address)
        self._queue: list[bytes] = []
        self._queued = 0
        self._heard_any = False
        wiring.selector.register(self._socket, selectors.EVENT_READ, self._read)
        self._channel = vehicle.open_channel(self, self.link)

    def _bind(self, address: Address, family: socket.AddressFamily) -> Any:
        """Take the local port; gives where to send to."""
        to = socket.getaddrinfo(address.host, address.port, family, socket.SOCK_DGRAM)[0][4]
        # Neighbours on the network are heard only where the vehicle talks to the network.
        self._socket.bind((address.host if is_loopback(str(to[0])) else "", address.local))
        return to

    def _name(self, address: Address) -> str:
        """The link URL for the other end."""
        return f"udpin:{address.host}:{address.port}"

    def clients(self) -> int:
        """1 once somebody has spoken."""
        return int(self._heard_any)

    def room(self) -> int:
        return BACKLOG_BYTES - self._queued

    def put(self, frame: bytes) -> None:
        self._queue.append(frame)
        self._queued += len(frame)
        self._wiring.waiting.add(self)

    def _read(self) -> None:
        for _ in range(READS_PER_TURN):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                continue  # nobody listens at the other end at present
            self._heard(sender)
            self._heard_any = True
            self._vehicle.receive(self._channel, data)
        self.flush()

    def _heard(self, sender: Any) -> None:
        """Somebody spoke; that changes nothing here."""

    def flush(self) -> bool:
        queue, self._queue, self._queued = self._queue, [], 0
        for frame in queue if self._to is not None else ():
            try:
                self._socket.sendto(frame, self._to)
            except OSError:
                continue  # lost, as datagrams are
        return True

    def close(self) -> None:
        self._wiring.selector.unregister(self._socket)
        self._socket.close()
        self._vehicle.close_channel(self._channel)


class LatchingUdp(UdpSender):
    """One of PX4's links: it sends to the port it was told, until somebody speaks, and from then on to that one only.
    Everybody is heard.
    """

    def _heard(self, sender: Any) -> None:
        if not self._heard_any:
            self._to = sender


class UdpListener(UdpSender):
    """Waits to be spoken to, and sends to who spoke last."""

    def _bind(self, address: Address, family: socket.AddressFamily) -> Any:
        self._socket.bind((address.host, address.port))

    def _name(self, address: Address) -> str:
        return f"udpout:{address.host}:{self.local_port}"

    def _heard(self, sender: Any) -> None:
        self._to = sender
