"""A UDP relay that delays and loses datagrams both ways: a bad link for processes on one host, without root."""

from __future__ import annotations

import heapq
import itertools
import random
import select
import socket
import threading
import time


class Relay:
    """``with Relay(port, delay, loss) as relay``: what is sent to loopback's ``relay.port`` reaches ``port``, and back.

    ``delay``: s each way, ``jitter``: s more or less; ``loss``: share of datagrams each way, all in the first ``after``
    seconds.
    """

    def __init__(
        self, port: int, delay: float, loss: float, jitter: float = 0.0, seed: int = 0, after: float = 0.0
    ) -> None:
        self._to, self._delay, self._jitter, self.loss = ("127.0.0.1", port), delay, jitter, loss
        self._rng, self._stop = random.Random(seed), threading.Event()
        self._opens = time.monotonic() + after
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self.port = int(self._near.getsockname()[1])
        self._far: dict[tuple[str, int], socket.socket] = {}
        self.passed = self.lost = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._thread.join()
        for each in (self._near, *self._far.values()):
            each.close()

    def _run(self) -> None:
        waiting: list[tuple[float, int, socket.socket, tuple[str, int], bytes]] = []
        count, callers = itertools.count(), {}
        while not self._stop.is_set():
            wait = 0.05 if not waiting else max(0.0, min(0.05, waiting[0][0] - time.monotonic()))
            readable, _, _ = select.select([self._near, *self._far.values()], [], [], wait)
            for each in readable:
                try:
                    data, sender = each.recvfrom(65536)
                except OSError:  # the other end is not there yet
                    continue
                if each is self._near:
                    if sender not in self._far:
                        self._far[sender] = far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                        far.bind(("127.0.0.1", 0))
                        callers[far] = sender
                    out, to = self._far[sender], self._to
                else:
                    out, to = self._near, callers[each]
                if self._rng.random() < self.loss or time.monotonic() < self._opens:
                    self.lost += 1
                    continue
                due = time.monotonic() + self._delay + self._rng.uniform(-self._jitter, self._jitter)
                heapq.heappush(waiting, (due, next(count), out, to, data))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, out, to, data = heapq.heappop(waiting)
                out.sendto(data, to)
                self.passed += 1
