"""UDP links: ``udpin`` listens and answers whom it heard, ``udpout`` speaks first to one address.

Either binds one local port and keeps it for the life of the link, whatever fails: PX4 answers only the first address it
heard on a link, until it is restarted. Neither connects its socket: an answer may come from another port than the one
spoken to, and an ICMP "port unreachable" must not end anything.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import struct
import sys
import time
from abc import abstractmethod

from zmav.errors import LinkDown
from zmav.links.base import Link, LinkCounters
from zmav.links.sockets import (
    DONTWAIT,
    MAX_READ,
    RECEIVE_BUFFER,
    Address,
    bind_error,
    grow_receive_buffer,
    is_loopback,
    resolve,
    set_read_wake,
    show,
)
from zmav.links.url import SocketUrl

logger = logging.getLogger(__name__)

MAX_PEERS = 16
SWEEP_S = 1.0
MOST_AT_ONCE = 256
"""datagrams that are put together: a flood must not keep what came first"""
SO_MEMINFO, MEMINFO_DROPS = 55, 8  # Linux: include/uapi/asm-generic/socket.h and linux/sock_diag.h
NO_ROUTE = frozenset({errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, errno.EADDRNOTAVAIL})


class UdpLink(Link):
    """What both kinds share: one bound socket for life."""

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(str(target))
        self._target = target
        self._sock: socket.socket | None = None

    @property
    def local_address(self) -> Address | None:
        """(host, port) of the local end, None before it is bound and after it is closed."""
        try:
            return self._sock.getsockname() if self._sock is not None else None
        except OSError:
            return None

    @property
    def counters(self) -> LinkCounters:
        self._count_drops()
        return self._counters

    def _count_drops(self) -> None:
        if sys.platform == "linux" and self._sock is not None:
            with contextlib.suppress(OSError, struct.error):
                meminfo = self._sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * (MEMINFO_DROPS + 1))
                self._counters.rx_dropped = struct.unpack_from("=I", meminfo, 4 * MEMINFO_DROPS)[0]

    def _bind(self, family: int, address: Address) -> None:
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            # No SO_REUSEADDR: with it a second program could bind the same port and take the datagrams.
            granted = grow_receive_buffer(sock)
            set_read_wake(sock)
            sock.bind(address)
        except OSError as error:
            sock.close()
            raise bind_error(error, address, self._target.scheme) from error
        if granted < RECEIVE_BUFFER:
            logger.warning(
                "%s: receive buffer of %d bytes instead of %d: raise net.core.rmem_max to lose less in bursts",
                self.url,
                granted,
                RECEIVE_BUFFER,
            )
        self._counters.rx_buffer = granted
        self._sock = sock

    @abstractmethod
    def _receive(self, sock: socket.socket, flags: int = 0) -> bytes: ...

    def _read(self) -> bytes:
        if self._sock is None:
            raise LinkDown("not bound", url=self.url)
        try:
            return self._receive(self._sock)
        except BlockingIOError:
            self._idle()
        except ConnectionError:
            pass  # an ICMP error to something sent before (some platforms report it here): says nothing of what comes
        return b""

    def _more(self) -> bytes:
        found: list[bytes] = []
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while self._sock is not None and (data := self._receive(self._sock, DONTWAIT)):
                found.append(data)
                if len(found) == MOST_AT_ONCE:
                    break
        return b"".join(found)

    def _idle(self) -> None:
        """Nothing came for a while."""

    def _release(self) -> None:
        if self._closing.is_set() and self._sock is not None:
            self._count_drops()
            self._sock.close()
            self._sock = None

    def _wake(self) -> None:
        if self._sock is not None:
            # Linux reports ENOTCONN for a socket that is not connected, and wakes the reader all the same.
            with contextlib.suppress(OSError):
                self._sock.shutdown(socket.SHUT_RDWR)


class UdpInLink(UdpLink):
    """Listens on HOST:PORT; CONNECTING until the first datagram, then UP.

    Sends to everyone heard in the last 10 s (at most 16: the longest silent gives way), and to the last one heard when
    all are silent, because a vehicle that cannot be heard may still hear. With nobody heard yet ``send`` returns False.
    """

    _up_when_open = False

    peer_life = 10.0
    """s: it sends to those that it heard within this time"""

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(target)
        self._peers: dict[Address, float] = {}  # the reader's own: address -> when last heard
        self._targets: tuple[Address, ...] = ()  # replaced as a whole, so that senders need no lock against the reader
        self._sweep_at = 0.0

    @property
    def peers(self) -> tuple[Address, ...]:
        """The addresses that ``send`` sends to."""
        return self._targets

    def _open(self) -> str:
        if self._sock is None:
            family, address = resolve(self._target.host, self._target.port, socket.SOCK_DGRAM)[0]
            self._bind(family, address)
        return f"listening on {show(self.local_address or (self._target.host, self._target.port))}, nobody heard yet"

    def _heard(self) -> str:
        return f"hearing {', '.join(map(show, self._targets))}"

    def _receive(self, sock: socket.socket, flags: int = 0) -> bytes:
        data, address = sock.recvfrom(MAX_READ, flags)
        if not data:
            return b""  # an empty datagram, or the socket was shut
        now = time.monotonic()
        new = address not in self._peers
        self._peers[address] = now
        if new or now >= self._sweep_at:
            self._sweep(now)
        return data

    def _idle(self) -> None:
        if self._peers:
            self._sweep(time.monotonic())

    def _sweep(self, now: float) -> None:
        """Forget who has been silent for too long, or who is one too many; never the last one heard."""
        self._sweep_at = now + SWEEP_S
        newest_first = sorted(self._peers, key=self._peers.__getitem__, reverse=True)[:MAX_PEERS]
        live = [address for address in newest_first if now - self._peers[address] < self.peer_life] or newest_first[:1]
        self._peers = {address: self._peers[address] for address in live}
        self._targets = tuple(live)

    def _write(self, data: bytes) -> int:
        sent = 0
        if self._sock is not None:
            for address in self._targets:
                try:
                    sent += self._sock.sendto(data, DONTWAIT, address)
                except OSError as error:
                    self._note(f"cannot send to {show(address)}: {error.strerror or error}")
        return sent


class UdpOutLink(UdpLink):
    """Speaks to HOST:PORT from one local port (``?local=PORT`` chooses it); UP means bound and a route exists.

    Anyone who answers is heard, from whatever port or address. For a remote on loopback the local end is too.
    """

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(target)
        self._remote: Address | None = None
        self._family = 0
        self._no_route = False  # set by a sender, met by the reader

    def _open(self) -> str:
        if self._remote is None:
            self._family, self._remote = resolve(self._target.host, self._target.port, socket.SOCK_DGRAM)[0]
        if self._sock is None:
            v6 = self._family == socket.AF_INET6
            any_host, loopback = ("::", "::1") if v6 else ("0.0.0.0", "127.0.0.1")
            host = loopback if is_loopback(str(self._remote[0])) else any_host
            self._bind(self._family, (host, self._target.local_port))
        self._check_route()
        return f"sending to {show(self._remote)} from port {(self.local_address or (0, 0))[1]}"

    def _check_route(self) -> None:
        """Ask the kernel for a route without sending anything: connect a UDP socket of its own for a moment."""
        if self._remote is None:
            raise LinkDown("not open", url=self.url)
        with socket.socket(self._family, socket.SOCK_DGRAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            try:
                probe.connect(self._remote)
            except OSError as error:
                raise LinkDown(f"no way to {show(self._remote)}: {error.strerror or error}", url=self.url) from error
        self._no_route = False

    def _receive(self, sock: socket.socket, flags: int = 0) -> bytes:
        return sock.recv(MAX_READ, flags)

    def _idle(self) -> None:
        if self._no_route:
            self._check_route()

    def _write(self, data: bytes) -> int:
        if self._sock is None or self._remote is None:
            return 0
        try:
            return self._sock.sendto(data, DONTWAIT, self._remote)
        except OSError as error:
            self._no_route = error.errno in NO_ROUTE
            raise
