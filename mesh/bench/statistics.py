"""What the receiver counts: datagrams by second, jitter, losses, outages, and the spread of many durations."""

from __future__ import annotations

import threading
from collections import deque
from statistics import quantiles

from zmav.wire.bench import BenchInterval, BenchOutage, Spread

SECOND = 1_000_000_000
MOST_SAMPLES = 200_000
MOST_OUTAGES = 10_000


class Samples:
    """Durations in ns, the last ones."""

    def __init__(self, most: int = MOST_SAMPLES) -> None:
        self._values: deque[int] = deque(maxlen=most)
        self.add = self._values.append

    def spread(self) -> Spread | None:
        """In seconds; None of nothing."""
        found = self._values.copy()  # at once: another thread may append meanwhile
        if not found:
            return None
        values = sorted(found)
        cuts = quantiles(values, n=100, method="inclusive") if len(values) > 1 else 99 * values
        low, median, p95, p99, high = (each / SECOND for each in (values[0], cuts[49], cuts[94], cuts[98], values[-1]))
        return Spread(count=len(values), min=low, median=median, p95=p95, p99=p99, max=high)


class _Count:
    """Of one interval, or of all."""

    def __init__(self) -> None:
        self.bytes = self.received = 0
        self.transit = Samples()


class Tally:
    """What a receiver makes of the datagrams of one run. :meth:`take` from Zenoh's thread, the rest from any.

    None comes twice: QUIC leaves out a repeated packet, and routers take one way.
    """

    def __init__(self, total: int, period_ns: int, gap_ns: int) -> None:
        self._total, self._period, self._gap = total, period_ns, gap_ns
        self._lock = threading.Lock()
        self._now, self._all = _Count(), _Count()
        self._intervals: list[BenchInterval] = []
        self._outages: list[BenchOutage] = []
        self._first: int | None = None
        self._last = 0
        self._highest, self._highest_before = -1, -1
        self._last_transit: int | None = None
        self._jitter = 0.0

    def take(self, number: int, sent_ns: int, size: int, now_ns: int) -> None:
        """One datagram, in the order of arrival; a number that the run does not have is left out."""
        with self._lock:
            if number >= self._total:
                return
            if self._first is None:
                self._first = self._last = now_ns
            self._roll(now_ns)
            if now_ns - self._last > self._gap and len(self._outages) < MOST_OUTAGES:
                start, length = (self._last - self._first) / SECOND, (now_ns - self._last) / SECOND
                self._outages.append(BenchOutage(start=start, length=length, lost=max(number - self._highest - 1, 0)))
            self._last = max(self._last, now_ns)
            self._highest = max(number, self._highest)
            transit = now_ns - sent_ns
            if self._last_transit is not None:
                self._jitter += (abs(transit - self._last_transit) - self._jitter) / 16.0
            self._last_transit = transit
            for count in (self._now, self._all):
                count.received += 1
                count.bytes += size
                count.transit.add(transit)

    def _roll(self, now: int) -> None:
        """Close the seconds that have passed."""
        assert self._first is not None
        while now - self._first >= (len(self._intervals) + 1) * SECOND:
            start = float(len(self._intervals))
            expected = self._highest - self._highest_before
            self._intervals.append(self._interval(self._now, start, start + 1.0, expected))
            self._now, self._highest_before = _Count(), self._highest

    def _interval(self, count: _Count, start: float, end: float, expected: int) -> BenchInterval:
        return BenchInterval(
            start=start,
            end=end,
            bytes=count.bytes,
            received=count.received,
            expected=max(expected, count.received),
            jitter=self._jitter / SECOND,
            transit=count.transit.spread(),
        )

    def intervals(self, now_ns: int, since: int, most: int = 60) -> list[BenchInterval]:
        """The seconds that have passed, from index ``since`` on."""
        with self._lock:
            if self._first is not None:
                self._roll(now_ns)
            return self._intervals[since : since + most]

    def outages(self, since: int, most: int = 100) -> list[BenchOutage]:
        with self._lock:
            return self._outages[since : since + most]

    def total(self) -> BenchInterval | None:
        """The whole run so far, to the end of the last datagram's time; None before the first."""
        with self._lock:
            if self._first is None:
                return None
            end = (self._last - self._first + self._period) / SECOND
            return self._interval(self._all, 0.0, end, self._highest + 1)
