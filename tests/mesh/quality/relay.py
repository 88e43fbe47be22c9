"""A UDP relay between two routers on loopback: what it loses, delays and slows is known to the byte."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import select
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType

Drop = Callable[[bytes], bool]
HEADERS = 28
"""bytes of IP and UDP"""


def nothing(data: bytes) -> bool:
    return False


def everything(data: bytes) -> bool:
    return True


class Relay:
    """From ``endpoint`` to the router at ``port`` and back. Direction 0 is there, 1 is back; all may be set live."""

    def __init__(self, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._listener.bind(("127.0.0.1", 0))
        self.target = ("127.0.0.1", port)
        self._there: dict[tuple[str, int], socket.socket] = {}
        self._back: dict[socket.socket, tuple[str, int]] = {}
        self.drop: list[Drop] = [nothing, nothing]
        self.delay = [0.0, 0.0]
        """s"""
        self.rate: float | None = None
        """bytes/s each way, IP and UDP headers included"""
        self._free = [0.0, 0.0]
        self.datagrams: list[list[int]] = [[], []]
        """sizes of what came, lost or not"""
        self._due: list[tuple[float, int, bytes, socket.socket, tuple[str, int] | None]] = []
        self._order = itertools.count()
        self._stop, self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def endpoint(self) -> str:
        return f"udp/127.0.0.1:{self._listener.getsockname()[1]}?rel=1;mixed_rel=1"

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._stop.close()
        self._thread.join()
        for each in (self._listener, self._wake, *self._back):
            each.close()

    def cut(self) -> None:
        self.drop = [everything, everything]

    def _run(self) -> None:
        while True:
            left = max(self._due[0][0] - time.monotonic(), 0.0) if self._due else None
            ready, _, _ = select.select([self._wake, self._listener, *self._back], [], [], left)
            if self._wake in ready:
                return
            for each in ready:
                self._take(each)
            while self._due and self._due[0][0] <= time.monotonic():
                _, _, data, out, to = heapq.heappop(self._due)
                with contextlib.suppress(OSError):  # nobody is there just now
                    out.sendto(data, to or self.target)

    def _take(self, each: socket.socket) -> None:
        try:
            data, source = each.recvfrom(65_536)
        except OSError:
            return
        if each is self._listener:
            if source not in self._there:
                out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._there[source], self._back[out] = out, source
            way, out, to = 0, self._there[source], None
        else:
            way, out, to = 1, self._listener, self._back[each]
        self.datagrams[way].append(len(data))
        if self.drop[way](data):
            return
        due = time.monotonic()
        if self.rate:
            self._free[way] = max(self._free[way], due) + (len(data) + HEADERS) / self.rate
            due = self._free[way]
        heapq.heappush(self._due, (due + self.delay[way], next(self._order), data, out, to))
