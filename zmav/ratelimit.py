"""Once in a while for each: what is said or asked again and again, by however many, is said and asked seldom."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Who = TypeVar("Who", bound=Hashable)


class RateLimit(Generic[Who]):
    """Once in ``every`` seconds for each, and for ``most`` within that time. Thread-safe.

    No more than ``most`` are remembered: a flood of new ones fills no memory, and is let through no faster.
    """

    def __init__(self, every: float, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._every, self._most, self._clock = every, most, clock
        self._last: dict[Who, tuple[float, int]] = {}
        """when each was let through, the earliest first, and how many of it were left out since"""
        self._lock = threading.Lock()

    def take(self, who: Who) -> int | None:
        """How many of it were left out since the last that was let through; None: this one is left out, too."""
        now = self._clock()
        with self._lock:
            before = self._last.get(who)
            if before is not None and now - before[0] < self._every:
                self._last[who] = (before[0], before[1] + 1)
                return None
            if before is None and len(self._last) >= self._most:
                oldest = next(iter(self._last))
                if now - self._last[oldest][0] < self._every:
                    return None
                del self._last[oldest]
            self._last.pop(who, None)
            self._last[who] = (now, 0)
            return before[1] if before is not None else 0

    def __len__(self) -> int:
        return len(self._last)
