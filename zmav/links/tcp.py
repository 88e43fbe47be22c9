"""TCP links: ``tcp`` connects to an autopilot or a server, ``tcpin`` waits for one peer at a time."""

from __future__ import annotations

import contextlib
import select
import socket

from zmav.errors import LinkDown
from zmav.links.base import LinkState
from zmav.links.sockets import (
    DONTWAIT,
    MAX_READ,
    READ_WAKE_S,
    Address,
    bind_error,
    grow_receive_buffer,
    resolve,
    set_read_wake,
    show,
)
from zmav.links.stream import StreamLink
from zmav.links.url import SocketUrl

CONNECT_S = 5.0
# What waits to be sent is bounded on purpose: a deep queue turns a slow peer into commands that arrive seconds late.
SEND_BUFFER = 64 * 1024
OUTBOX = 32 * 1024
# A peer that vanished without a word is noticed within about this long, by keepalive when the link is idle and by
# TCP_USER_TIMEOUT when something is unacknowledged. The latter also ends a connection whose peer, though alive, has not
# read for so long that nothing more can be sent.
DEAD_PEER_S = 15
KEEPALIVE_IDLE_S, KEEPALIVE_INTERVAL_S, KEEPALIVE_PROBES = 5, 2, 5

# What poll says of a peer that closed its end. POLLRDHUP is Linux's; elsewhere POLLHUP alone must do.
LEAVING: int = select.POLLHUP | getattr(select, "POLLRDHUP", 0)


def set_stream_options(sock: socket.socket) -> None:
    """No Nagle delay, a bounded send buffer, and keepalive that finds a dead peer."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", KEEPALIVE_IDLE_S),
        ("TCP_KEEPINTVL", KEEPALIVE_INTERVAL_S),
        ("TCP_KEEPCNT", KEEPALIVE_PROBES),
        ("TCP_USER_TIMEOUT", DEAD_PEER_S * 1000),
    ):
        if hasattr(socket, name):  # not every platform has them all
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def shut(sock: socket.socket | None) -> None:
    """Wake the thread that is blocked in this socket, in whatever state it is."""
    if sock is not None:
        with contextlib.suppress(OSError):
            sock.shutdown(socket.SHUT_RDWR)


class TcpStream(StreamLink):
    """What both kinds share: one connected socket, written without blocking."""

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(str(target), OUTBOX)
        self._target = target
        self._peer: socket.socket | None = None  # connected

    def _write_some(self, data: bytes) -> int:
        if self._peer is None:
            raise LinkDown(f"nobody is connected: {self._detail}", url=self.url)
        try:
            return self._peer.send(data, DONTWAIT)
        except BlockingIOError:
            return 0

    def _write(self, data: bytes) -> int:
        return super()._write(data) if self._peer is not None else 0

    def _drop_peer(self) -> None:
        with self._tx_lock:
            peer, self._peer = self._peer, None
            self._outbox.clear()
        if peer is not None:
            peer.close()

    def _wake(self) -> None:
        shut(self._peer)


class TcpLink(TcpStream):
    """Connects to HOST:PORT and reconnects for ever; UP means connected."""

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(target)
        self._trying: socket.socket | None = None

    def _open(self) -> str:
        error: OSError | None = None
        for family, address in resolve(self._target.host, self._target.port, socket.SOCK_STREAM):
            try:
                self._connect(family, address)
            except OSError as failed:
                error = failed
                continue
            return f"connected to {show(address)}"
        why = (error.strerror or str(error)) if error else "no address"
        raise LinkDown(f"cannot connect to {self._target.host} port {self._target.port}: {why}", url=self.url)

    def _connect(self, family: int, address: Address) -> None:
        sock = socket.socket(family, socket.SOCK_STREAM)
        self._trying = sock
        try:
            if self._closing.is_set():
                raise ConnectionAbortedError("closing")
            self._counters.rx_buffer = grow_receive_buffer(sock)
            set_stream_options(sock)
            sock.settimeout(CONNECT_S)
            sock.connect(address)
            if sock.getsockname() == sock.getpeername():
                # A port in the ephemeral range that nobody listens on can be connected to itself.
                raise ConnectionRefusedError("nobody listens there")
            sock.settimeout(None)
            set_read_wake(sock)
        except BaseException:
            sock.close()
            raise
        finally:
            self._trying = None
        self._peer = sock

    def _read(self) -> bytes:
        if self._peer is None:
            raise LinkDown("not connected", url=self.url)
        self._flush()
        try:
            data = self._peer.recv(MAX_READ)
        except BlockingIOError:
            return b""
        if not data:
            raise LinkDown(f"{self._target.host} port {self._target.port} closed the connection", url=self.url)
        return data

    def _release(self) -> None:
        self._drop_peer()

    def _wake(self) -> None:
        shut(self._trying)
        super()._wake()


class TcpInLink(TcpStream):
    """Listens on HOST:PORT and serves one peer at a time; CONNECTING while there is none, UP while there is.

    A further peer is accepted and closed at once, and counted in ``counters.refused``.
    """

    _up_when_open = False

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(target)
        self._listener: socket.socket | None = None
        self._poller = select.poll()
        self._peer_name = ""

    @property
    def local_address(self) -> Address | None:
        """Where it listens, None while it does not."""
        try:
            return self._listener.getsockname() if self._listener is not None else None
        except OSError:
            return None

    def _open(self) -> str:
        family, address = resolve(self._target.host, self._target.port, socket.SOCK_STREAM)[0]
        self._listener = sock = socket.socket(family, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # for TCP: only skips the wait for old connections
        self._counters.rx_buffer = grow_receive_buffer(sock)  # inherited by accepted sockets
        try:
            sock.bind(address)
            sock.listen(16)
        except OSError as error:
            raise bind_error(error, address, self._target.scheme) from error
        sock.setblocking(False)
        self._poller.register(sock, select.POLLIN)
        return self._waiting()

    def _waiting(self) -> str:
        return f"waiting for a peer at {show(self.local_address or (self._target.host, self._target.port))}"

    def _read(self) -> bytes:
        self._flush()
        events = dict(self._poller.poll(READ_WAKE_S * 1000))
        if self._closing.is_set():
            return b""
        peer, data, leaving = self._peer, b"", 0
        if peer is not None and peer.fileno() in events:
            leaving = events.pop(peer.fileno()) & LEAVING
            data = self._receive(peer)
        # What remains is the listener. A peer that is leaving is read to its end first, so that its successor (often
        # the same program, restarted) is not turned away.
        if events and not leaving:
            self._accept()
        return data

    def _receive(self, peer: socket.socket) -> bytes:
        try:
            data = peer.recv(MAX_READ, DONTWAIT)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._peer_left(f"lost {self._peer_name}: {error.strerror or error}")
            return b""
        if not data:
            self._peer_left(f"{self._peer_name} closed the connection")
        return data

    def _accept(self) -> None:
        if self._listener is None:
            raise LinkDown("not listening", url=self.url)
        try:
            sock, address = self._listener.accept()
        except (BlockingIOError, ConnectionError):
            return  # it went away again before it was accepted
        if self._peer is not None:
            self._counters.refused += 1
            self._note(f"turned away {show(address)}: {self._peer_name} is connected, and one peer at a time is served")
            sock.close()
            return
        set_stream_options(sock)
        self._poller.register(sock, select.POLLIN | LEAVING)
        self._peer_name = show(address)
        self._peer = sock
        self._set_state(LinkState.UP, f"{self._peer_name} is connected")

    def _peer_left(self, why: str) -> None:
        if self._peer is not None:
            self._poller.unregister(self._peer)
        self._drop_peer()
        if not self._closing.is_set():
            self._note(why)
            self._set_state(LinkState.CONNECTING, f"{why}; {self._waiting()}")

    def _release(self) -> None:
        self._drop_peer()
        self._poller = select.poll()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _wake(self) -> None:
        shut(self._listener)
        super()._wake()
