"""TCP links: ``tcp`` connects to an autopilot or a server."""

from __future__ import annotations

import contextlib
import socket

from zmav.errors import LinkDown
from zmav.links.sockets import (
    DONTWAIT,
    MAX_READ,
    Address,
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


class TcpLink(StreamLink):
    """Connects to HOST:PORT and reconnects for ever; UP means connected. Written without blocking."""

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(str(target), OUTBOX)
        self._target = target
        self._peer: socket.socket | None = None  # connected
        self._trying: socket.socket | None = None

    def _write_some(self, data: bytes) -> int:
        if self._peer is None:
            raise LinkDown(f"nobody is connected: {self._detail}", url=self.url)
        try:
            return self._peer.send(data, DONTWAIT)
        except BlockingIOError:
            return 0

    def _write(self, data: bytes) -> int:
        return super()._write(data) if self._peer is not None else 0

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
        with self._tx_lock:
            peer, self._peer = self._peer, None
            self._outbox.clear()
        if peer is not None:
            peer.close()

    def _wake(self) -> None:
        shut(self._trying)
        shut(self._peer)
