"""Frames of one message from one system, many at a time: for transfers, where each frame's own wake-up would cost more
than its work.
"""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable
from types import TracebackType

from zmav.mavlink import Frame
from zmav.services.link.port import Port, on_loop
from zmav.waiting import within

BREATH = 64
"""frames taken before others on the event loop have their turn"""


class Mailbox:
    """Frames of message ``name`` from ``source`` while the ``with`` lasts, in order. Read it on the event loop.

    Unlike :class:`zmav.services.link.port.Inbox` it decodes nothing.
    """

    def __init__(self, port: Port, source: tuple[int, int], name: str) -> None:
        self._port, self._source, self._name = port, source, name
        self._frames: collections.deque[Frame] = collections.deque()
        self._news = asyncio.Event()
        self._rung = False
        self._taken = 0
        self._ring: Callable[..., None] = lambda: None
        self._stop: Callable[[], None] = lambda: None

    def __enter__(self) -> Mailbox:
        self._ring = on_loop(asyncio.get_running_loop(), self._wake)
        self._stop = self._port.listen(self._name, self._on_frame)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._stop()

    def _on_frame(self, frame: Frame) -> None:
        """In the link's reader thread, which wakes the loop once for many frames."""
        if (frame.sysid, frame.compid) == self._source:
            self._frames.append(frame)
            if not self._rung:
                self._rung = True
                self._ring()

    def _wake(self) -> None:
        self._rung = False
        self._news.set()

    async def get(self, timeout: float) -> Frame | None:
        """The next frame; None when none came within ``timeout`` seconds."""
        self._taken += 1
        if self._taken % BREATH == 0:
            await asyncio.sleep(0)
        while not self._frames:
            self._news.clear()
            if self._frames:
                break
            try:
                await within(timeout, self._news.wait())
            except asyncio.TimeoutError:
                return None
        return self._frames.popleft()
