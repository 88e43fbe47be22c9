"""One neighbour: what its probes told, and the probes for it."""

from __future__ import annotations

import statistics
import time
from collections import deque
from dataclasses import dataclass

from mesh.quality.stamp import CLOCK, Stamp, clock

ROUND_TRIPS = 20
"""the median of so many"""
QUIET = 3.0
"""periods without a stamp, and at least ``PATIENCE``, after which those that are missing count as lost"""
PATIENCE = 1.0
WINDOW = 60
"""numbers looked back at: of 60 with 10 % loss, the share found is off by 4 % (one standard deviation)"""
LEAST = 8
"""numbers before anything is said"""
NUMBERS = 1 << 32
RESTART = 10_000
"""a jump of more numbers than this is a stream that began again"""


class LossWindow:
    """Which share of a numbered stream does not come, over its last numbers: modulo 2^32, in any order, some twice."""

    def __init__(self, size: int = WINDOW) -> None:
        self._size, self._all = size, (1 << size) - 1
        self._highest: int | None = None
        self._seen = 0  # bit k: the number k below the highest came
        self._expected = 0

    def came(self, number: int) -> bool:
        """Count one; False: it came before, or is too old to tell."""
        if self._highest is None:
            return self._begin(number)
        ahead = (number - self._highest + NUMBERS // 2) % NUMBERS - NUMBERS // 2
        if abs(ahead) > RESTART:
            return self._begin(number)
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & self._all
            self._expected = min(self._expected + ahead, self._size)
            self._highest = number
            return True
        if -ahead >= self._expected or self._seen >> -ahead & 1:
            return False
        self._seen |= 1 << -ahead
        return True

    def _begin(self, number: int) -> bool:
        self._highest, self._seen, self._expected = number, 1, 1
        return True

    def share(self, overdue: int = 0) -> float | None:
        """0 to 1; ``overdue`` more numbers should have come since the highest. None: too few to say."""
        expected = min(self._expected + overdue, self._size)
        if expected < LEAST:
            return None
        kept = max(expected - overdue, 0)
        return 1.0 - (self._seen & ((1 << kept) - 1)).bit_count() / expected


@dataclass(frozen=True)
class Figures:
    """What is known of a link now; None: not known."""

    age: float | None
    silent: bool
    rtt: float | None
    rtt_min: float | None
    loss_in: float | None
    loss_out: float | None


class Meter:
    """The probes to and from one neighbour. On one thread; times are monotonic seconds."""

    def __init__(self, own: bytes, born: float | None = None) -> None:
        self._own = own
        self._number = 0
        self.begin(time.monotonic() if born is None else born)

    def begin(self, now: float) -> None:
        """The link is up, or up again: what was known of it before is over. Our own numbers go on."""
        self.born = now
        self.heard: float | None = None
        self.period: float | None = None
        """s between the neighbour's stamps, as it says"""
        self._last: Stamp | None = None
        self._loss = LossWindow()
        self._rtts: deque[float] = deque(maxlen=ROUND_TRIPS)

    # What we send.

    def stamp(self, now: float, period: float) -> bytes:
        """The next stamp, to be sent at once."""
        self._number = (self._number + 1) % NUMBERS
        held = None if self._last is None or self.heard is None else int((now - self.heard) * 1e6)
        return Stamp(
            self._own,
            period,
            self._number,
            clock(now),
            echo=self._last.sent if self._last else 0,
            held=held,
            loss=self._loss.share(self._overdue(now)),
        ).pack()

    # What comes.

    def take(self, probe: Stamp, now: float) -> None:
        """A probe came at ``now``."""
        fresh = self._loss.came(probe.number)
        if not fresh or (self._last and (probe.sent - self._last.sent) % CLOCK > CLOCK // 2):
            return  # a copy, or one that was overtaken: it counts as come, and tells nothing new
        self.heard, self.period, self._last = now, probe.period, probe
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
            loss_in=self._loss.share(self._overdue(now)),
            loss_out=self._last.loss if self._last else None,
        )
