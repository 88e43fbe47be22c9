"""What waits to be sent to one WebSocket: the newest of each key, no more often than asked, in bounded memory."""

from __future__ import annotations

import asyncio
import collections
import heapq
import time
from typing import Generic, TypeVar

from zmav.waiting import within

T = TypeVar("T")
Slot = tuple[int, str]
"""a subscription's number and a key"""
MOST_KEYS = 4096
"""keys told apart by one socket: invented ones must not fill the memory"""
MOST_QUEUED = 1000
"""samples that wait in order where none may be left out"""


class Outbox(Generic[T]):
    """Of each key only the newest sample waits, and goes when its subscription's next turn is. Lives on the event loop.

    What must all arrive (events) waits in a queue of its own, whose bound a reader that is too slow will feel.
    """

    def __init__(self) -> None:
        self._newest: dict[Slot, T] = {}
        self._next: dict[Slot, float] = {}
        """when a key may be sent again (monotonic seconds)"""
        self._late: list[tuple[float, Slot]] = []
        """keys that wait for their turn: a heap"""
        self._ready: collections.deque[Slot] = collections.deque()
        self._queue: collections.deque[tuple[int, T]] = collections.deque()
        self._arrived = asyncio.Event()
        self.dropped = 0
        """samples lost because there was no room: those left out by a rate cap are none of them"""

    def put(self, number: int, key: str, sample: T) -> None:
        """Take a sample of the subscription ``number``; the one before it, if still here, is out of date."""
        slot = (number, key)
        if slot not in self._next:
            if len(self._next) >= MOST_KEYS and not self._make_room():
                self.dropped += 1
                return
            self._next[slot] = 0.0
        if slot not in self._newest:
            if (due := self._next[slot]) <= time.monotonic():
                self._ready.append(slot)
            else:
                heapq.heappush(self._late, (due, slot))
        self._newest[slot] = sample
        self._arrived.set()

    def _make_room(self) -> bool:
        """Forget keys of which nothing waits and that may be sent again at any time."""
        now = time.monotonic()
        self._next = {slot: due for slot, due in self._next.items() if slot in self._newest or due > now}
        return len(self._next) < MOST_KEYS

    def queue(self, number: int, sample: T) -> None:
        """Take a sample that goes in order and is not replaced."""
        if len(self._queue) >= MOST_QUEUED:
            self.dropped += 1
            return
        self._queue.append((number, sample))
        self._arrived.set()

    def forget(self, number: int) -> None:
        """Leave out what waits for a subscription that has ended."""
        for held in (self._newest, self._next):
            for slot in [slot for slot in held if slot[0] == number]:
                del held[slot]
        self._ready = collections.deque(slot for slot in self._ready if slot[0] != number)
        self._late = [late for late in self._late if late[1][0] != number]
        heapq.heapify(self._late)
        self._queue = collections.deque(item for item in self._queue if item[0] != number)

    async def get(self, period: dict[int, float]) -> T:
        """The next sample that may go; ``period`` are the seconds between two of a key, by subscription."""
        while True:
            self._arrived.clear()
            if self._queue:
                return self._queue.popleft()[1]
            now = time.monotonic()
            while self._late and self._late[0][0] <= now:
                self._ready.append(heapq.heappop(self._late)[1])
            if self._ready:
                slot = self._ready.popleft()
                self._next[slot] = now + period.get(slot[0], 0.0)
                return self._newest.pop(slot)
            await self._wait(self._late[0][0] - now if self._late else None)

    async def _wait(self, seconds: float | None) -> None:
        if seconds is None:
            await self._arrived.wait()
            return
        try:
            await within(seconds, self._arrived.wait())
        except asyncio.TimeoutError:
            return
