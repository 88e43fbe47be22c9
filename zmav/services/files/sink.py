"""What a transfer fills: the ranges of a file that are missing, where its bytes go, and how far it is."""

from __future__ import annotations

import bisect
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # readers of files in the key space load this, too, and take no orders
    from zmav.services.orders.orders import Report

REPORT_EVERY = 0.2
"""s between two reports"""


class Gaps:
    """Missing byte ranges, each from its start up to but not including its end; sorted, apart, none empty."""

    def __init__(self, ranges: list[tuple[int, int]]) -> None:
        self._ranges = [(start, end) for start, end in ranges if start < end]

    def __bool__(self) -> bool:
        return bool(self._ranges)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(list(self._ranges))

    @property
    def total(self) -> int:
        """Bytes missing."""
        return sum(end - start for start, end in self._ranges)

    def fill(self, start: int, end: int) -> int:
        """These bytes came; gives how many of them had been missing."""
        i = bisect.bisect_right(self._ranges, start, key=lambda gap: gap[1])
        new = 0
        while i < len(self._ranges) and self._ranges[i][0] < end and start < end:
            low, high = self._ranges[i]
            left, right = (low, max(low, start)), (min(high, end), high)
            new += right[0] - left[1]
            self._ranges[i : i + 1] = kept = [gap for gap in (left, right) if gap[0] < gap[1]]
            i += len(kept)
        return new

    def cut(self, size: int) -> None:
        """The file ends at ``size``: nothing is missing behind it."""
        self.fill(size, max([size, *(end for _, end in self._ranges)]))

    def merged(self, apart: int) -> list[tuple[int, int]]:
        """The gaps, those joined that lie less than ``apart`` bytes from each other."""
        found: list[tuple[int, int]] = []
        for start, end in self:
            if found and start - found[-1][1] < apart:
                found[-1] = (found[-1][0], end)
            else:
                found.append((start, end))
        return found


class Sink(Protocol):
    """Where a file's bytes go."""

    gaps: Gaps

    def put(self, offset: int, data: bytes) -> int:
        """Take these bytes; gives how many of them had been missing."""

    def cut(self, size: int) -> None:
        """The file ends here."""


class TransferMeter:
    """Counts bytes into a report of ``bytes``, ``size`` and ``rate`` in bytes/s, a few times a second and at the end.

    ``have``: what was there already, and is no merit of this transfer's rate.
    """

    def __init__(self, report: Report, size: int, have: int = 0) -> None:
        self._report, self._size = report, size
        self._bytes, self._have = have, have
        self._began, self._reported = time.monotonic(), 0.0

    def add(self, count: int) -> None:
        self._bytes += count
        now = time.monotonic()
        if now - self._reported >= REPORT_EVERY or self._bytes >= self._size:
            self._reported = now
            self._report({"bytes": self._bytes, "size": self._size, "rate": round(self.rate)})

    @property
    def rate(self) -> float:
        """Bytes a second since the start."""
        return (self._bytes - self._have) / max(time.monotonic() - self._began, 1e-6)
