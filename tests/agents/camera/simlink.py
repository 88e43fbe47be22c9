"""A camera, a link and a reader in simulated time: what the budget does, without waiting for it."""

from __future__ import annotations

import heapq
import random
import statistics
from collections.abc import Callable

from agents.camera.budget import Budget
from agents.camera.quality_steps import QualitySteps
from agents.camera.settings import CameraSettings
from zmav.vision.assembler import Assembler
from zmav.vision.chunks import count_of, split
from zmav.vision.parity import needed
from zmav.wire import FrameReport

FULL_BYTES = 40_000
"""of a picture of full size and quality 70"""
REPORT = 0.5
LATENCY = 0.03


class SimLink:
    """``loss``: share of chunks at random; ``rate``: B/s that pass, ``queue``: bytes that wait for it."""

    def __init__(
        self,
        settings: CameraSettings,
        loss: float = 0.0,
        rate: float | None = None,
        queue: float = 3000.0,
        clock: float = 0.0,
    ) -> None:
        self.budget, self.quality, self.assembler = Budget(settings), QualitySteps(settings), Assembler()
        self.loss, self.rate, self.queue = loss, rate, queue
        self.now = 1000.0
        self.sent = self.lost = self.bytes = 0
        self.delays: list[float] = []
        self._clock, self._rng = clock, random.Random(3)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._serial = self._seq = 0
        self._free = 0.0
        self._before = (0, 0, 0)
        self._recent: list[float] = []
        self._at(0.0, self._picture)
        self._at(REPORT, self._report)

    def run(self, seconds: float) -> None:
        """Let time pass; the counts begin again."""
        self.sent = self.lost = self.bytes = 0
        self.assembler.whole = self.assembler.torn = 0
        self._before = (0, 0, self.assembler.bytes)
        self.delays.clear()
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, _, call = heapq.heappop(self._events)
            call()
        self.now = end

    @property
    def whole(self) -> float:
        """Share of pictures."""
        return self.assembler.whole / max(self.assembler.whole + self.assembler.torn, 1)

    def _at(self, after: float, call: Callable[[], None]) -> None:
        self._serial += 1
        heapq.heappush(self._events, (self.now + after, self._serial, call))

    def _picture(self) -> None:
        taken = self.now
        self.budget.expire(self.now)
        step = self.quality.choose(self.budget.bytes, self.budget.loss)
        length = int(FULL_BYTES * (step.quality / 70) ** 1.1 * (0.3 if step.half else 1.0))
        self.quality.learn(step, length)
        spare = needed(count_of(length), self.budget.loss)
        chunks = split(bytes(length), sender=1, seq=self._seq, t=taken, size=(640, 480), spare=spare)
        after, total, rate = 0.0, sum(map(len, chunks)), self.budget.bytes
        self.budget.sent.add(self._seq, total, min(length / (1.0 - self.budget.loss), total) / rate, self.now)
        for chunk in chunks:
            self._at(after, lambda chunk=chunk: self._put(chunk))  # type: ignore[misc]
            after += len(chunk) / rate
        self._seq += 1
        self._at(max(after, 1.0 / step.rate), self._picture)

    def _put(self, chunk: bytes) -> None:
        self.sent += 1
        self.bytes += len(chunk)
        wait = 0.0
        if self.rate is not None:
            self._free = max(self._free, self.now)
            wait = self._free - self.now
            if wait * self.rate > self.queue:
                self.lost += 1
                return
            self._free += len(chunk) / self.rate
        if self._rng.random() < self.loss:
            self.lost += 1
            return
        self._at(wait + LATENCY, lambda: self._came(chunk))

    def _came(self, chunk: bytes) -> None:
        whole = self.assembler.add(chunk, self.now)
        if whole is not None:
            self.delays.append(self.now - whole.t)
            self._recent.append(self.now + self._clock - whole.t)

    def _report(self) -> None:
        a = self.assembler
        a.expire(self.now)
        whole, torn, came = self._before
        report = FrameReport(
            t=self.now + self._clock,
            seq=a.seq or 0,
            whole=a.whole - whole,
            torn=a.torn - torn,
            delay=statistics.median(self._recent) if self._recent else None,
            rate_bytes=(a.bytes - came) / REPORT,
        )
        self._before = (a.whole, a.torn, a.bytes)
        self._recent.clear()
        self._at(LATENCY, lambda: self.budget.report("reader", report, self.now))
        self._at(REPORT, self._report)
