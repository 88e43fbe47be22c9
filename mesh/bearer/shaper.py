"""What may leave through a radio that has a budget, and what waits there: a queue as short as can be, and a fair one.

The queue is short so that the links above learn at once that there is no more room: what waits in Zenoh's queues is
sorted by priority, what waits here is not. A neighbour's flood takes nothing from another: they take turns by bytes.
"""

from __future__ import annotations

import collections
from collections.abc import Iterator
from typing import Generic, TypeVar

LARGEST = 1500
"""bytes of a datagram with its IP and UDP headers, as Ethernet carries it"""
BURST = 0.04
"""s of the budget that may leave at once after a silence: no second holds more than 5 % above the budget"""


class Bucket:
    """A token bucket: tokens are bytes, come at ``rate`` a second, and ``depth`` of them are kept at most.

    What leaves in any ``t`` seconds is at most ``rate * t + depth``, where no single datagram is larger than ``depth``.
    """

    def __init__(self, rate: float, now: float) -> None:
        self.rate = rate
        self.depth = max(BURST * rate, float(LARGEST))
        self._tokens, self._at = self.depth, now

    def take(self, size: int, now: float) -> bool:
        """Take ``size`` bytes' tokens if they are there; a larger datagram than the bucket waits for a full one."""
        self._fill(now)
        if self._tokens < min(size, self.depth):
            return False
        self._tokens -= size
        return True

    def wait(self, size: int, now: float) -> float:
        """Seconds until :meth:`take` will give so many."""
        self._fill(now)
        return max(min(size, self.depth) - self._tokens, 0.0) / self.rate

    def _fill(self, now: float) -> None:
        self._tokens = min(self._tokens + self.rate * max(now - self._at, 0.0), self.depth)
        self._at = max(now, self._at)


QUEUE = 0.03
"""s of the budget that may wait: less, and QUIC does not fill the radio (at 15 ms half of 1 Mbit/s); more is delay"""
FEWEST = 2
"""datagrams of full size that may wait for each neighbour, however slow the radio. One would do for nobody: QUIC sends
two at a time. With four, setpoints take 47 ms instead of 27 at 1 Mbit/s, and at 5 kB/s no link opens in time"""
MOST_FIRST = 16
"""probes and echoes that may wait"""


T = TypeVar("T")


class Shaper(Generic[T]):
    """Items by neighbour (any hashable), each with its size as the radio carries it, headers included."""

    def __init__(self, rate: float, now: float) -> None:
        self.bucket = Bucket(rate, now)
        self._room = QUEUE * rate
        self._queues: collections.OrderedDict[object, collections.deque[tuple[T, int]]] = collections.OrderedDict()
        self._waiting: collections.Counter[object] = collections.Counter()
        self._credit: collections.Counter[object] = collections.Counter()
        self._first: collections.deque[tuple[T, int]] = collections.deque()
        self._stuck: int | None = None
        """bytes of what the bucket had no tokens for"""

    def put(self, neighbour: object, item: T, size: int) -> bool:
        """Have ``item`` wait; False where there is no room for it."""
        queue = self._queues.setdefault(neighbour, collections.deque())
        room = max(self._room / len(self._queues), FEWEST * LARGEST)
        if self._waiting[neighbour] + size > room and self._waiting[neighbour]:
            return False
        queue.append((item, size))
        self._waiting[neighbour] += size
        return True

    def put_first(self, item: T, size: int) -> bool:
        """Have ``item`` leave before all else: what measures the path must not wait behind what is carried."""
        if len(self._first) >= MOST_FIRST:
            return False
        self._first.append((item, size))
        return True

    def take(self, now: float) -> Iterator[T]:
        """What may leave now, in order."""
        self._stuck = None
        while self._first:
            if not self._pays(self._first[0][1], now):
                return
            yield self._first.popleft()[0]
        while self._queues:
            neighbour, queue = next(iter(self._queues.items()))
            item, size = queue[0]
            if self._credit[neighbour] < size:
                self._credit[neighbour] += LARGEST
                self._queues.move_to_end(neighbour)
                continue
            if not self._pays(size, now):
                return
            queue.popleft()
            self._credit[neighbour] -= size
            self._waiting[neighbour] -= size
            if not queue:
                del self._queues[neighbour], self._credit[neighbour], self._waiting[neighbour]
            yield item

    def _pays(self, size: int, now: float) -> bool:
        paid = self.bucket.take(size, now)
        self._stuck = None if paid else size
        return paid

    def wait(self, now: float) -> float | None:
        """Seconds until what :meth:`take` left behind may leave; None where it left nothing."""
        return self.bucket.wait(self._stuck, now) if self._stuck is not None else None

    def __len__(self) -> int:
        """Bytes that wait."""
        return sum(self._waiting.values()) + sum(size for _, size in self._first)
