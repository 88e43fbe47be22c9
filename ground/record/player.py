"""Plays recordings in step: one clock for all of them, in their own time, faster, or as fast as they are taken."""

from __future__ import annotations

import heapq
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from ground.record.sources import Record, Source
from zmav.links.base import Link, LinkFinished

LONGEST_STEP_S = 60.0
"""a longer step between two records, or one backwards, is a clock that was set, or a pause: it is played as no time"""
WAITING = 1000
"""frames that wait for a vehicle's agent, before all wait for it"""


class FedLink(Link):
    """A link whose frames are given to it; it is down for good at the end. Nothing can be sent: nobody listens."""

    recorded = True

    def __init__(self, name: str) -> None:
        super().__init__(f"replay:{name}")
        self._taken = threading.Event()
        self._frames: queue.Queue[bytes | None] = queue.Queue(WAITING)

    def feed(self, frame: bytes | None) -> None:
        """Give it a frame, or its end; waits while too many do. Once it is closed, they are nobody's."""
        while not self._closing.is_set():
            try:
                self._frames.put(frame, timeout=0.25)
                return
            except queue.Full:
                continue

    def wait_taken(self) -> None:
        """Wait until all that was given, its end included, is taken, or the link is closed."""
        while not (self._taken.wait(0.25) or self._closing.is_set()):
            pass

    def _open(self) -> str:
        return f"playing {self.url.partition(':')[2]}"

    def _read(self) -> bytes:
        try:
            frame = self._frames.get(timeout=0.25)
        except queue.Empty:
            return b""
        if frame is None:
            self._taken.set()
            raise LinkFinished("end of recording")
        return frame

    def _write(self, data: bytes) -> int:
        return 0

    def _release(self) -> None:
        pass


Deliver = Callable[[Record], None]


class Player:
    """Plays each source to its own ``deliver``, called in the player's thread.

    ``speed``: times real time, 0 for as fast as possible; ``start``: s after the earliest record. ``now`` and ``pause``
    are for tests: a clock in seconds, and a wait of so many seconds that returns True when the player is being closed.
    """

    def __init__(
        self,
        parts: Sequence[tuple[Source, Deliver]],
        speed: float = 1.0,
        loop: bool = False,
        start: float = 0.0,
        now: Callable[[], float] = time.monotonic,
        pause: Callable[[float], bool] | None = None,
    ) -> None:
        self._parts, self._speed, self._loop, self._start = list(parts), speed, loop, start
        self._stop = threading.Event()
        self._now, self._pause = now, pause or self._stop.wait
        self.played = 0
        self.error: Exception | None = None
        self.over = threading.Event()
        """all was played, or nothing more can be"""
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def _run(self) -> None:
        try:
            while self._play() and self._loop and not self._stop.is_set():
                pass
        except Exception as e:  # a file that cannot be read any more: said by anyone who waits for the end
            self.error = e
        finally:
            self.over.set()

    def _play(self) -> bool:
        """Once; False where there is nothing to be played."""
        begin = min((first for source, _ in self._parts if (first := source.first()) is not None), default=None)
        if begin is None:
            return False
        since = begin + int(self._start * 1e9)
        last, due, before = since, self._now(), self.played
        for record, deliver in self._merged(since):
            step = (record.at - last) / 1e9
            last = record.at
            if self._speed:
                due += step / self._speed if 0.0 < step <= LONGEST_STEP_S else 0.0
                delay = due - self._now()
                if delay > 0 and self._pause(delay):
                    return False
            if self._stop.is_set():
                return False
            deliver(record)
            self.played += 1
        return self.played > before

    def _merged(self, since: int) -> Iterator[tuple[Record, Deliver]]:
        def tagged(source: Source, deliver: Deliver) -> Iterator[tuple[Record, Deliver]]:
            return ((record, deliver) for record in source.records(since))

        return heapq.merge(*(tagged(*part) for part in self._parts), key=lambda each: each[0].at)
