"""Frames by UDP, as they came, one a datagram: to the port of anyone who asked for a system's messages."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from ground.feed import Origin
from ground.http.gateway import Gateway
from ground.http.reply import Failure
from zmav.links.sockets import is_loopback
from zmav.process import free_port

MOST = 64
"""streams at once"""
REFUSED_FOR = 5.0
"""s after the last refusal for which a port counts as unreachable: routers and kernels say it once a second at most"""
ASK_EVERY = 10.0
"""s between two times that the messages of a stream are asked for"""
MOST_ORIGINS = 4096
"""messages of components that one stream's cap tells apart"""
PLAIN_HZ = 4.0
"""the rate of named messages where no rate is given"""


@dataclass(frozen=True)
class Wish:
    """What a stream carries: ``compid`` 0 is every component, no ``messages`` is every message, ``hz`` 0 no cap."""

    sysid: int
    compid: int
    messages: tuple[str, ...] = ()
    hz: float = 0.0


class FrameStream:
    """One stream: frames go out on Zenoh's thread as they come; those that come too soon for the cap are left out, and
    so is what the kernel does not take at once.
    """

    def __init__(self, wish: Wish, host: str, port: int) -> None:
        self.wish, self.host, self.port = wish, host, port
        self.asked = self.renewed = time.monotonic()
        self._refused = self._first_refused = 0.0
        self._due: dict[Origin, float] = {}
        self._lock = threading.Lock()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((host, port))

    def close(self) -> None:
        with self._lock:
            self._socket.close()

    def on_frame(self, origin: Origin, frame: bytes) -> None:
        wish = self.wish
        if origin.sysid != wish.sysid or (wish.compid and origin.compid != wish.compid):
            return
        if wish.messages and origin.message not in wish.messages:
            return
        with self._lock:
            if not wish.hz or self._is_due(origin, 1.0 / wish.hz):
                self._send(frame)

    def unreachable(self, now: float) -> float:
        """Seconds since which nobody has received it; 0 where somebody may."""
        with self._lock:
            if now - self._refused > REFUSED_FOR:
                self._first_refused = 0.0
            return now - self._first_refused if self._first_refused else 0.0

    def _is_due(self, origin: Origin, period: float) -> bool:
        now, due = time.monotonic(), self._due.get(origin, 0.0)
        if now < due:
            return False
        if len(self._due) >= MOST_ORIGINS:
            self._due.clear()  # invented messages: the others may come too soon, once
        self._due[origin] = max(due + period, now + 0.5 * period)  # what is a little early is not left out
        return True

    def _send(self, frame: bytes) -> None:
        for _ in range(2):  # the first may only tell that an earlier one was refused
            try:
                self._socket.send(frame)
                return
            except BlockingIOError:
                return
            except OSError:
                self._refused = time.monotonic()
                self._first_refused = self._first_refused or self._refused


class FrameStreams:
    """The streams there are, by asker, system, component and port. On the event loop."""

    def __init__(self, gateway: Gateway, timeout: float = 60.0) -> None:
        self._gateway, self._timeout = gateway, timeout
        self._streams: dict[tuple[str, int, int, int], FrameStream] = {}
        self._sweeper: asyncio.TimerHandle | None = None
        self._remove = gateway.add_listener(self._on_frame)
        gateway.at_end(self.close)

    def start(self, host: str, wish: Wish, port: int | None = None) -> FrameStream:
        """Begin a stream to ``port`` of ``host``, or go on with the one there is, as it is wished for now.

        Raises :class:`Failure` where there are too many, or no port is free.
        """
        place = (host, wish.sysid, wish.compid)
        before = next((s for key, s in self._streams.items() if key[:3] == place and port in (None, s.port)), None)
        if before is not None:
            before.asked = time.monotonic()
            before.wish = wish
            self._ask(before)
            return before
        if len(self._streams) >= MOST:
            raise Failure(429, "too_many", f"there are {MOST} streams already: end one with /stop/SYSTEM/COMPONENT")
        stream = self._open(wish, host, port)
        self._streams = {**self._streams, (*place, stream.port): stream}
        self._ask(stream)
        if self._sweeper is None:
            self._sweeper = asyncio.get_running_loop().call_later(1.0, self._sweep)
        return stream

    def stop(self, host: str, sysid: int, compid: int, port: int | None = None) -> int:
        """End the streams of a system to ``host`` (``compid`` 0: of all its components); returns how many."""
        ended = [
            key
            for key in self._streams
            if key[:2] == (host, sysid) and compid in (0, key[2]) and port in (None, key[3])
        ]
        for key in ended:
            self._end(key)
        return len(ended)

    def of(self, host: str) -> Sequence[FrameStream]:
        return [stream for key, stream in sorted(self._streams.items()) if key[0] == host]

    def __len__(self) -> int:
        return len(self._streams)

    def close(self) -> None:
        self._remove()
        if self._sweeper is not None:
            self._sweeper.cancel()
        for key in list(self._streams):
            self._end(key)

    def _on_frame(self, origin: Origin, frame: bytes) -> None:
        for stream in self._streams.values():  # replaced and never changed: this is Zenoh's thread
            stream.on_frame(origin, frame)

    def _end(self, key: tuple[str, int, int, int]) -> None:
        stream = self._streams[key]
        self._streams = {other: kept for other, kept in self._streams.items() if other != key}
        stream.close()

    def _open(self, wish: Wish, host: str, port: int | None) -> FrameStream:
        if port is None:
            if not is_loopback(host):
                raise Failure(400, "bad_input", "say with ?port= to which UDP port of yours")
            port = free_port(socket.SOCK_DGRAM, host)
        try:
            return FrameStream(wish, host, port)
        except OSError as e:
            raise Failure(502, "link", f"nothing can be sent to {host} port {port}: {e.strerror}") from e

    def _ask(self, stream: FrameStream) -> None:
        """Have the autopilots send the messages that a stream names."""
        stream.renewed = time.monotonic()
        for vehicle in self._gateway.vehicle_of(stream.wish.sysid) if stream.wish.messages else ():
            for message in stream.wish.messages:
                self._gateway.wants.want(vehicle.name, message, stream.wish.hz or PLAIN_HZ, fleet=vehicle.fleet)

    def _sweep(self) -> None:
        now = time.monotonic()
        for key, stream in list(self._streams.items()):
            if stream.unreachable(now) > self._timeout and now - stream.asked > self._timeout:
                self._end(key)
            elif now - stream.renewed > ASK_EVERY:
                self._ask(stream)
        self._sweeper = asyncio.get_running_loop().call_later(1.0, self._sweep) if self._streams else None
