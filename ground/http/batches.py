"""Frames from Zenoh's thread to the event loop, with one wake-up for all that came meanwhile."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable

from ground.feed import Origin
from ground.http.gateway import Gateway
from zmav.services.link.port import on_loop

MOST = 10_000
"""frames that wait for a loop that is busy; then the oldest go"""
Batch = list[tuple[Origin, bytes]]


class Batches:
    """Calls ``on_batch(frames)`` on the loop in the order in which they came, until :meth:`close`."""

    def __init__(self, gateway: Gateway, on_batch: Callable[[Batch], None]) -> None:
        self._on_batch = on_batch
        self._waiting: collections.deque[tuple[Origin, bytes]] = collections.deque(maxlen=MOST)
        self._called = False
        self._wake = on_loop(asyncio.get_running_loop(), self._deliver)
        self._remove = gateway.add_listener(self._on_frame)

    def close(self) -> None:
        self._remove()
        self._waiting.clear()

    def _on_frame(self, origin: Origin, frame: bytes) -> None:
        self._waiting.append((origin, frame))
        if not self._called:
            self._called = True
            self._wake()

    def _deliver(self) -> None:
        self._called = False  # first: a frame that comes from now on wakes us again
        batch = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if batch:
            self._on_batch(batch)
