"""UDP endpoints: ``udp`` sends to a station that waits for it, ``udpin`` answers anyone who speaks to it."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import time
from abc import abstractmethod

from ground.gcs.client import Client
from ground.gcs.options import Endpoint
from ground.gcs.places import MOST_CLIENTS, Hub, SocketEndpoint
from zmav.links.sockets import (
    DONTWAIT,
    MAX_READ,
    Address,
    bind_error,
    grow_receive_buffer,
    is_loopback,
    resolve,
    set_read_wake,
    show,
)
from zmav.mavlink import Splitter

SEND_BUFFER = 1 << 20
"""bytes: a burst of a whole fleet's telemetry"""


class Peer:
    """One address behind a socket that others share."""

    stream = False

    def __init__(self, sock: socket.socket, address: Address) -> None:
        self._sock, self.address = sock, address

    def write(self, data: bytes) -> int:
        try:
            return self._sock.sendto(data, DONTWAIT, self.address)
        except OSError:  # full, no route for now, or nobody there: a datagram may be lost, the way to it stays
            return 0

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def close(self) -> None:
        """The socket is the endpoint's."""


class _Udp(SocketEndpoint):
    """A socket for datagrams."""

    def _bind(self, family: int, address: Address, scheme: str) -> socket.socket:
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            grow_receive_buffer(sock)
            set_read_wake(sock)
            sock.bind(address)
        except OSError as error:
            sock.close()
            raise bind_error(error, address, scheme) from error
        self._sock = sock
        return sock

    def _run(self) -> None:
        assert self._sock is not None
        receive = self._sock.recvfrom
        while not self._closing.is_set():
            try:
                data, address = receive(MAX_READ)
            except OSError:  # nothing came for a while, or an answer to something sent: says nothing of what comes
                self._idle(time.monotonic())
                continue
            if data:
                self._hear(data, address)

    @abstractmethod
    def _hear(self, data: bytes, address: Address) -> None: ...

    @abstractmethod
    def _idle(self, now: float) -> None:
        """Nothing came for a while."""


class UdpOut(_Udp):
    """``--udp``: one station, which need not be there yet. It answers to where frames come from, from any of its ports.

    A broadcast address reaches anyone who waits there, and anyone who answers is the station from then on.
    """

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        super().__init__(endpoint, hub)
        self._client: Client | None = None

    @property
    def clients(self) -> list[Client]:
        return [self._client] if self._client is not None else []

    def start(self) -> None:
        family, target = resolve(self.endpoint.host, self.endpoint.port, socket.SOCK_DGRAM)[0]
        v6 = family == socket.AF_INET6
        host = ("::1" if v6 else "127.0.0.1") if is_loopback(str(target[0])) else ("::" if v6 else "0.0.0.0")
        self._target, self._for_many = target, _is_for_many(target)
        self._peer = Peer(self._bind(family, (host, 0), "udpout"), target)
        self._client = Client(str(self.endpoint), self._peer, self.endpoint.options, self._hub.dialect, stays=True)
        self._hub.joined(self._client)
        self._thread.start()

    def _hear(self, data: bytes, address: Address) -> None:
        client = self._client
        if client is None or (address[0] != self._target[0] and not self._for_many):
            self.turned_away += 1
            return
        frames = client.feed(data)
        if frames and self._peer.address != address:
            self._hub.news(f"{client.name} answers from {show(address)}")
            self._peer.address = address
        for frame in frames:
            self._hub.said(client, frame)

    def _idle(self, now: float) -> None:
        if self._client is not None and not self._client.present:
            self._peer.address = self._target  # it may come back where it was waited for


class UdpIn(_Udp):
    """``--udpin``: any number of stations, each there from its first good frame until it is silent for a while."""

    def __init__(self, endpoint: Endpoint, hub: Hub) -> None:
        super().__init__(endpoint, hub)
        self._clients: dict[Address, Client] = {}
        self._sweep_at = 0.0

    @property
    def clients(self) -> list[Client]:
        return list(self._clients.values())

    def start(self) -> None:
        family, address = resolve(self.endpoint.host, self.endpoint.port, socket.SOCK_DGRAM)[0]
        self._bind(family, address, "udpin")
        self._thread.start()

    def _hear(self, data: bytes, address: Address) -> None:
        now = time.monotonic()
        if now >= self._sweep_at:
            self._idle(now)
        client = self._clients.get(address) or self._welcome(data, address)
        if client is not None:
            self._take(client, data)

    def _welcome(self, data: bytes, address: Address) -> Client | None:
        """A client for somebody new, where it speaks MAVLink and there is room."""
        room = len(self._clients) < MOST_CLIENTS
        if not room or not any(frame.verified for frame in Splitter(self._hub.dialect).feed(data)):
            self.turned_away += 1
            return None
        assert self._sock is not None
        name = f"udpin {show(address)}"
        client = Client(name, Peer(self._sock, address), self.endpoint.options, self._hub.dialect)
        self._clients[address] = client
        client.heard = time.monotonic()
        self._hub.joined(client)
        return client

    def _idle(self, now: float) -> None:
        self._sweep_at = now + 1.0
        for address, client in list(self._clients.items()):
            if not client.present:
                del self._clients[address]
                self._hub.left(client, f"silent for {client.silence:.0f} s")


def _is_for_many(address: Address) -> bool:
    """A multicast address, or one that is a broadcast address in most networks."""
    with contextlib.suppress(ValueError):
        found = ipaddress.ip_address(str(address[0]).partition("%")[0])
        return found.is_multicast or found.packed[-1] == 255
    return False
