"""uvicorn in the event loop that the process has already, and clients that stop reading dropped by the kernel."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import functools
import logging
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from typing import Any, NamedTuple

import uvicorn
from starlette.types import ASGIApp, Scope
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from ground.http.guard import ADMITTED
from zmav.errors import BadConfig, PortInUse

STALLED = 20.0
"""s after which a connection is cut whose other end takes nothing of what was sent, or is silent to the kernel"""
CONNECTIONS = 256
"""connections and requests at once; beyond it the answer is 503"""
MESSAGE_SIZE = 1_000_000
"""bytes in one WebSocket message from a client"""
IDLE, IDLE_EACH = CONNECTIONS // 2, CONNECTIONS // 8
"""connections without a request under way, and those of one address: beyond it the oldest is shut"""
SEND_BUFFER = 262_144
"""bytes that the kernel keeps for a client that does not read"""
LONGEST_HEAD = 65_536
"""bytes of a request's line and headers"""


class Patience(NamedTuple):
    """Seconds for a connection's next request to come whole, but for its body."""

    head: float = 15.0
    stranger: float = 4.0
    """where no request on it was let in as yet"""


PATIENCE = Patience()


class _Protocol(H11Protocol):
    """Closes a connection whose next request does not come: there are only so many at once.

    Connections that ask nothing hold at most half of them, and those of one address an eighth. What was let in once
    (:data:`ground.http.guard.ADMITTED`) goes last.
    """

    _patience: asyncio.TimerHandle | None = None
    _since = 0.0
    _admitted = False

    def __init__(self, patience: Patience, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._wait = patience

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.app_state = {**self.app_state, TRANSPORT: transport}
        self._wait_for_next()
        others = (each for each in self.connections if isinstance(each, _Protocol) and each is not self)
        idle = [each for each in others if each._is_idle()]
        mine = [each for each in idle if each.client and self.client and each.client[0] == self.client[0]]
        for those, most in ((mine, IDLE_EACH), (idle, IDLE)):
            if len(those) >= most:
                min(those, key=lambda each: (each._admitted, each._since)).transport.close()
                return

    def _is_idle(self) -> bool:
        return not self.transport.is_closing() and _answered(self.cycle)

    def on_response_complete(self) -> None:
        self._admitted = self._admitted or ADMITTED in self.scope["state"]
        self._wait_for_next()
        super().on_response_complete()

    def _wait_for_next(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
        self._since = self.loop.time()
        patience = self._wait.head if self._admitted else self._wait.stranger
        self._patience = self.loop.call_later(patience, self._hurry, self.cycle)

    def _hurry(self, before: object) -> None:
        if self.cycle is before and self.transport.get_protocol() is self:  # a WebSocket's has taken its place
            self.transport.close()


def _answered(cycle: RequestResponseCycle | None) -> bool:
    """No request is under way; there is no cycle until the first one."""
    return cycle is None or cycle.response_complete


TRANSPORT = "zmav.transport"
"""in a scope's state: the connection's"""
UNSENT = 16_384
"""bytes that may wait in the kernel to be sent, of what goes on for ever"""


def send_the_newest(scope: Scope) -> None:
    """From now on ``send`` returns only when all but :data:`UNSENT` bytes before it have gone out: for who sends the
    newest of something, again and again. Until then the kernel would take half a megabyte for one that does not read.
    """
    transport: asyncio.Transport | None = scope.get("state", {}).get(TRANSPORT)
    if transport is None:
        return  # another server's
    transport.set_write_buffer_limits(high=0)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)


WRITE = "zmav.write"
"""an extension of ASGI: whole frames of a WebSocket, as they are, many at a time and without a task for each client"""
Write = Callable[[Sequence[bytes]], bool]
"""False, and nothing is written, where ``send`` would wait, or refuse"""


class _WebSocket(WebSocketsSansIOProtocol):
    """Offers :data:`WRITE`: what many clients get alike is made once for all of them."""

    def handle_connect(self, event: Any) -> None:
        super().handle_connect(event)
        if self.response.status_code == 101:
            extensions: Any = self.scope["extensions"]
            extensions[WRITE] = self._write

    def _write(self, frames: Sequence[bytes]) -> bool:
        if not self.writable.is_set() or self.close_sent or self.conn.state is not State.OPEN:
            return False
        if self.disconnected or self.transport.is_closing():
            return False
        self.transport.write(b"".join(frames))
        return True


def write_of(scope: Scope) -> Write:
    """How frames are written at once to a WebSocket that was accepted; never, where the server cannot."""
    found: Write = (scope.get("extensions") or {}).get(WRITE, lambda frames: False)
    return found


def text_frame(data: bytes) -> bytes:
    """A whole text message as one frame from a server (RFC 6455, 5.2). ``data``: UTF-8."""
    size = len(data)
    if size < 126:
        return bytes((0x81, size)) + data
    if size < 1 << 16:
        return b"\x81\x7e" + size.to_bytes(2, "big") + data
    return b"\x81\x7f" + size.to_bytes(8, "big") + data


class _Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals are this process's own affair: :func:`zmav.process.until_stopped`."""
        yield


def bound(host: str, port: int, stalled: float = STALLED) -> socket.socket:
    """A listening socket's address taken; raises :class:`PortInUse`, or :class:`BadConfig` for a host that is not ours.

    TCP_USER_TIMEOUT and the buffer's size go over to every connection: who leaves sent bytes unread for that long is
    cut off, whatever face it asked, and takes no more memory. Where nothing is sent, as for a camera that is silent,
    the kernel asks whether the other end is there.
    """
    try:
        family, kind, proto, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as e:
        text = f"--host {host}: {e.strerror or e}"
        raise BadConfig(text, field="host", value=host, expected="a name or an address of this computer") from e
    sock = socket.socket(family, kind, proto)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * stalled))
        if hasattr(socket, "TCP_KEEPIDLE"):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL):
                sock.setsockopt(socket.IPPROTO_TCP, option, max(1, int(stalled / 2)))
        sock.bind(address)
        return sock
    except OSError as e:
        sock.close()
        if e.errno == errno.EADDRINUSE:
            text = f"port {port} of {host} is in use by another program: choose another with --port"
            raise PortInUse(text, host=host, port=port) from e
        text = f"cannot listen on {host} port {port}: {e.strerror}"
        raise BadConfig(text, field="host", value=f"{host}:{port}", expected="an address of this computer") from e


@contextlib.asynccontextmanager
async def serving(app: ASGIApp, sock: socket.socket, patience: Patience = PATIENCE) -> AsyncIterator[int]:
    """Serve ``app`` while the ``async with`` lasts; gives the port."""
    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # a client's bad bytes are no news
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        lifespan="off",
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS,
        h11_max_incomplete_event_size=LONGEST_HEAD,
        http=functools.partial(_Protocol, patience),  # type: ignore[arg-type]  # it is only called
        ws=_WebSocket,
        ws_max_size=MESSAGE_SIZE,
        ws_ping_interval=10.0,
        ws_ping_timeout=20.0,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=2,
    )
    server = _Server(config)
    task = asyncio.create_task(server.serve(sockets=[sock]))
    try:
        while not server.started and not task.done():
            await asyncio.sleep(0.01)
        if task.done():
            task.result()
        yield sock.getsockname()[1]
    finally:
        server.should_exit = True
        await asyncio.gather(task, return_exceptions=True)
        sock.close()
