"""One neighbour: what its probes told, and the probes for it."""

from __future__ import annotations

import statistics
import time
from collections import deque
from dataclasses import dataclass

from mesh.quality.loss import NUMBERS, Jitter, LossWindow
from mesh.quality.stamp import CLOCK, Car, Stamp, clock
from mesh.quality.throughput import Dispersion

ROUND_TRIPS = 20
"""the median of so many"""
QUIET = 3.0
"""periods without a stamp, and at least ``PATIENCE``, after which those that are missing count as lost"""
PATIENCE = 1.0


@dataclass(frozen=True)
class Figures:
    """What is known of a link now; None: not known."""

    age: float | None
    silent: bool
    rtt: float | None
    rtt_min: float | None
    jitter: float | None
    loss_in: float | None
    loss_out: float | None
    throughput_in: float | None
    throughput_out: float | None


class Meter:
    """The probes to and from one neighbour. On one thread; times are monotonic seconds."""

    def __init__(self, own: bytes, born: float | None = None) -> None:
        self._own = own
        self._number = self._train = 0
        self.begin(time.monotonic() if born is None else born)

    def begin(self, now: float) -> None:
        """The link is up, or up again: what was known of it before is over. Our own numbers go on."""
        self.born = now
        self.heard: float | None = None
        self.period: float | None = None
        """s between the neighbour's stamps, as it says"""
        self._last: Stamp | None = None
        self._loss, self._jitter, self._dispersion = LossWindow(), Jitter(), Dispersion()
        self._rtts: deque[float] = deque(maxlen=ROUND_TRIPS)

    # What we send.

    def stamp(self, now: float, period: float) -> bytes:
        """The next stamp, to be sent at once."""
        self._number = (self._number + 1) % NUMBERS
        self._dispersion.settle(now)
        held = None if self._last is None or self.heard is None else int((now - self.heard) * 1e6)
        return Stamp(
            self._own,
            period,
            self._number,
            clock(now),
            echo=self._last.sent if self._last else 0,
            held=held,
            loss=self._loss.share(self._overdue(now)),
            throughput=self._dispersion.rate,
        ).pack()

    def train(self, count: int) -> list[bytes]:
        """The next train, to be sent at once."""
        self._train = (self._train + 1) % 0x1_0000
        return [Car(self._own, self._train, index, count).pack() for index in range(count)]

    # What comes.

    def take(self, probe: Stamp | Car, now: float) -> None:
        """A probe came at ``now``."""
        if isinstance(probe, Car):
            self._dispersion.came(probe, now)
            return
        fresh = self._loss.came(probe.number)
        if not fresh or (self._last and (probe.sent - self._last.sent) % CLOCK > CLOCK // 2):
            return  # a copy, or one that was overtaken: it counts as come, and tells nothing new
        self.heard, self.period, self._last = now, probe.period, probe
        self._jitter.came((clock(now) - probe.sent) % CLOCK / 1e6)
        rtt = probe.rtt(clock(now))
        if rtt is not None:
            self._rtts.append(rtt)

    # What it tells.

    def _overdue(self, now: float) -> int:
        """Stamps that should have come since the last one; none as long as they may only be late."""
        if self.heard is None or self.period is None:
            return 0
        silence = now - self.heard
        return int(silence / self.period) if silence > self._quiet() else 0

    def _quiet(self) -> float:
        return max(PATIENCE, QUIET * (self.period or 0.0))

    def figures(self, now: float) -> Figures:
        age = None if self.heard is None else now - self.heard
        return Figures(
            age=age,
            silent=(now - self.born if age is None else age) > self._quiet(),
            rtt=statistics.median(self._rtts) if self._rtts else None,
            rtt_min=min(self._rtts, default=None),
            jitter=self._jitter.value,
            loss_in=self._loss.share(self._overdue(now)),
            loss_out=self._last.loss if self._last else None,
            throughput_in=self._dispersion.rate,
            throughput_out=self._last.throughput if self._last else None,
        )
