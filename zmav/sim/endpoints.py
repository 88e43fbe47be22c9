"""Where simulated vehicles are reached: TCP servers for any number of clients, and UDP senders that keep one local
port.

``tcp`` or ``tcp:[HOST:]PORT[+STEP]`` listens (port 0: any free one; ``+STEP`` adds that much per vehicle), as
ArduPilot's SERIAL0 does at 5760+10*i. ``udp:HOST:PORT[+STEP]`` sends there, as SITL does, from a local port that stays
the same; whoever answers is heard.

``px4`` is both of PX4's links: ``onboard`` binds 14580+i and sends to 14540+i (from the eleventh vehicle on all to
14549), ``ground`` binds 18570+i and sends to 14550. ``onboard:LOCAL[+STEP]:[HOST:]REMOTE[+STEP]``, and ``ground``
likewise, names other ports (local port 0: any free one). Such a link sends to whoever spoke first on it, until the
vehicle's end is opened again.
"""

from __future__ import annotations

import errno
import selectors
import socket
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import msgspec

from zmav.errors import BadUrl, PortInUse
from zmav.sim.protocol.channel import Channel, Outlet

BACKLOG_BYTES = 64 * 1024  # what a client that does not read may leave standing
READ_BYTES = 65536
READS_PER_TURN = 16  # so that a flood on one link does not starve the others
_EXPECTED = (
    "tcp, tcp:[HOST:]PORT[+STEP], udp:HOST:PORT[+STEP], px4, onboard:LOCAL[+STEP]:[HOST:]REMOTE[+STEP] or ground:..."
)
_PX4_LINKS = {"onboard": "14580+1:14540+1", "ground": "18570+1:14550"}
_ONBOARD_REMOTES = 10  # different ports that PX4 sends to


class Address(msgspec.Struct, frozen=True):
    """A parsed endpoint."""

    kind: str
    host: str
    port: int
    local: int = 0
    """the port that one of PX4's links is bound to; 0: any"""


def expand(texts: Sequence[str]) -> list[str]:
    """Each endpoint by itself: "px4" stands for two."""
    return [each for text in texts for each in (list(_PX4_LINKS) if text == "px4" else [text])]


def parse_endpoint(text: str, index: int, host: str = "127.0.0.1") -> Address:
    """The address of vehicle ``index`` (0, 1, ...). Raises :class:`BadUrl` naming what is expected."""
    kind, _, rest = text.partition(":")
    if kind in _PX4_LINKS:
        return _parse_px4(kind, _PX4_LINKS[kind] if text == kind else rest, index, host, text)
    if kind == "tcp" and not rest:
        rest = "5760+10"
    place, plus, step = rest.partition("+")
    name, _, port = place.rpartition(":")
    if (
        kind not in ("tcp", "udp")
        or not port.isdigit()
        or (plus and step and not step.isdigit())
        or (kind == "udp" and not name)
    ):
        raise BadUrl(f"no endpoint {text!r}; expected {_EXPECTED}", field="endpoint", value=text, expected=_EXPECTED)
    number = int(port)
    if number:
        number += index * (int(step or 1) if plus else 0)
    if number > 65535 or (kind == "udp" and number == 0):
        raise BadUrl(
            f"no port {number} in {text!r}; expected 1 to 65535", field="endpoint", value=text, expected=_EXPECTED
        )
    return Address(kind, name or host, number)


def _parse_px4(kind: str, rest: str, index: int, host: str, text: str) -> Address:
    local, _, remote = rest.partition(":")
    name, _, port = remote.rpartition(":")
    found = [_stepped(local, index), _stepped(port, min(index, _ONBOARD_REMOTES - 1) if kind == "onboard" else index)]
    if None in found or not found[1]:
        raise BadUrl(f"no endpoint {text!r}; expected {_EXPECTED}", field="endpoint", value=text, expected=_EXPECTED)
    return Address(kind, name or host, found[1] or 0, found[0] or 0)


def _stepped(text: str, index: int) -> int | None:
    """``PORT[+STEP]`` for vehicle ``index``; port 0 stays 0. None where that is no port."""
    place, plus, step = text.partition("+")
    if not place.isdigit() or (plus and step and not step.isdigit()):
        return None
    number = int(place)
    number += index * (int(step or 1) if plus else 0) if number else 0
    return number if number <= 65535 else None


class Switchboard(Protocol):
    """The vehicle behind an endpoint."""

    def open_channel(self, outlet: Outlet, link: str = "") -> Channel: ...

    def close_channel(self, channel: Channel) -> None: ...

    def receive(self, channel: Channel, data: bytes) -> None: ...


class Endpoint(Protocol):
    """A way to reach one vehicle; all methods are called in the world's thread (or before it runs)."""

    url: str

    def clients(self) -> int: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


def open_endpoint(address: Address, node: Switchboard, selector: selectors.BaseSelector) -> Endpoint:
    """Open it and have ``selector`` watch it; each key's ``data`` is a function to call when it is ready.

    Raises :class:`PortInUse` where another program listens there, :class:`BadUrl` where there is no such address.
    """
    try:
        return _KINDS.get(address.kind, LatchingUdp)(address, node, selector)
    except OSError as error:
        where = f"{address.kind}:{address.host}:{address.local or address.port}"
        if error.errno == errno.EADDRINUSE:
            raise PortInUse(f"{where} is in use by another program", port=address.local or address.port) from error
        raise BadUrl(f"{where}: {error}", field="endpoint", value=where, expected=_EXPECTED) from error


def _is_loopback(host: str) -> bool:
    return host.startswith("127.") or host == "::1"


class TcpServer:
    """Listens; every client is a channel of its own."""

    def __init__(self, address: Address, node: Switchboard, selector: selectors.BaseSelector) -> None:
        self._node = node
        self._selector = selector
        self._clients: list[TcpClient] = []
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.create_server((address.host, address.port), family=family, backlog=16)
        self._socket.setblocking(False)
        self.port = int(self._socket.getsockname()[1])
        self.url = f"tcp:{address.host}:{self.port}"
        selector.register(self._socket, selectors.EVENT_READ, self._accept)

    def clients(self) -> int:
        return len(self._clients)

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except OSError:
            return  # it left before it was let in
        self._clients.append(TcpClient(connection, self._node, self._selector, self._clients.remove))

    def flush(self) -> None:
        for client in list(self._clients):
            client.flush()

    def close(self) -> None:
        for client in list(self._clients):
            client.close()
        self._selector.unregister(self._socket)
        self._socket.close()


class TcpClient:
    """One connection."""

    def __init__(
        self,
        connection: socket.socket,
        node: Switchboard,
        selector: selectors.BaseSelector,
        gone: Callable[[TcpClient], None],
    ) -> None:
        self._socket = connection
        self._node = node
        self._selector = selector
        self._gone = gone
        self._backlog = bytearray()
        self._open = True
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        selector.register(connection, selectors.EVENT_READ, self._read)
        self._channel = node.open_channel(self)

    def room(self) -> int:
        return BACKLOG_BYTES - len(self._backlog)

    def put(self, frame: bytes) -> None:
        self._backlog += frame

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
            self._node.receive(self._channel, data)
        self.flush()

    def flush(self) -> None:
        if not self._backlog or not self._open:
            return
        try:
            sent = self._socket.send(self._backlog)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.close()
            return
        del self._backlog[:sent]

    def close(self) -> None:
        if not self._open:
            return
        self._open = False
        self._selector.unregister(self._socket)
        self._socket.close()
        self._node.close_channel(self._channel)
        self._gone(self)


class UdpSender:
    """Sends to one address, one frame a datagram, from one local port; takes what anybody sends to that port."""

    def __init__(self, address: Address, node: Switchboard, selector: selectors.BaseSelector) -> None:
        self._node = node
        self._selector = selector
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            info = socket.getaddrinfo(address.host, address.port, family, socket.SOCK_DGRAM)
            self._to = info[0][4]
            # Neighbours on the network are heard only where the vehicle talks to the network.
            self._socket.bind((address.host if _is_loopback(str(self._to[0])) else "", address.local))
        except OSError:
            self._socket.close()
            raise
        self.url = f"udpin:{address.host}:{address.port}"
        self.local_port = int(self._socket.getsockname()[1])
        self._queue: list[bytes] = []
        self._queued = 0
        selector.register(self._socket, selectors.EVENT_READ, self._read)
        self._channel = node.open_channel(self, address.kind)

    def clients(self) -> int:
        return 1

    def room(self) -> int:
        return BACKLOG_BYTES - self._queued

    def put(self, frame: bytes) -> None:
        self._queue.append(frame)
        self._queued += len(frame)

    def _read(self) -> None:
        for _ in range(READS_PER_TURN):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                continue  # nobody listens at the other end at present
            self._heard(sender)
            self._node.receive(self._channel, data)
        self.flush()

    def _heard(self, sender: Any) -> None:
        """Somebody spoke; that changes nothing here."""

    def flush(self) -> None:
        queue, self._queue, self._queued = self._queue, [], 0
        for frame in queue:
            try:
                self._socket.sendto(frame, self._to)
            except OSError:
                continue  # lost, as datagrams are

    def close(self) -> None:
        self._selector.unregister(self._socket)
        self._socket.close()
        self._node.close_channel(self._channel)


class LatchingUdp(UdpSender):
    """One of PX4's links: it sends to the port it was told, until somebody speaks, and from then on to that one only.
    Everybody is heard.
    """

    def __init__(self, address: Address, node: Switchboard, selector: selectors.BaseSelector) -> None:
        super().__init__(address, node, selector)
        self._latched = False

    def _heard(self, sender: Any) -> None:
        if not self._latched:
            self._to, self._latched = sender, True


_KINDS: dict[str, Callable[[Address, Switchboard, selectors.BaseSelector], Endpoint]] = {
    "tcp": TcpServer,
    "udp": UdpSender,
}
