"""What is still missing of a file that comes in pieces, in any order and some of them twice."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Iterator

UNKNOWN = 1 << 32
"""stands for the end of a file whose size is not known"""


class Gaps:
    """Missing byte ranges, each from its start up to but not including its end; sorted, apart, none empty."""

    def __init__(self, ranges: Iterable[tuple[int, int]]) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        for start, end in ranges:
            if start < end:
                self._starts.append(start)
                self._ends.append(end)

    def __bool__(self) -> bool:
        return bool(self._starts)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(list(zip(self._starts, self._ends, strict=True)))

    def __len__(self) -> int:
        return len(self._starts)

    @property
    def first(self) -> int:
        """Where the first gap begins."""
        return self._starts[0]

    @property
    def total(self) -> int:
        """Bytes missing."""
        return sum(self._ends) - sum(self._starts)

    def fill(self, start: int, end: int) -> int:
        """These bytes came; gives how many of them had been missing."""
        if start >= end:
            return 0
        i = bisect.bisect_right(self._ends, start)
        new = 0
        while i < len(self._starts) and self._starts[i] < end:
            low, high = self._starts[i], self._ends[i]
            left, right = (low, max(low, start)), (min(high, end), high)
            new += right[0] - left[1]
            kept = [r for r in (left, right) if r[0] < r[1]]
            self._starts[i : i + 1] = [r[0] for r in kept]
            self._ends[i : i + 1] = [r[1] for r in kept]
            i += len(kept)
        return new

    def cut(self, size: int) -> None:
        """The file ends at ``size``: nothing is missing behind it."""
        self.fill(size, max(UNKNOWN, size))

    def merged(self, apart: int) -> list[tuple[int, int]]:
        """The gaps, those joined that lie less than ``apart`` bytes from each other."""
        found: list[tuple[int, int]] = []
        for start, end in self:
            if found and start - found[-1][1] < apart:
                found[-1] = (found[-1][0], end)
            else:
                found.append((start, end))
        return found
