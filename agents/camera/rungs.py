"""Which of a camera's streams fits into what the link takes: the richest that does, or else key frames of the
leanest.
"""

from __future__ import annotations

FITS = 0.8
"""of what a stream needs that has to be there for it: a little too little costs some units now and then"""
SHORT_S = 3.0
"""s of too little after which a leaner one is taken"""
FIRST_WAIT, LONGEST_WAIT = 12.0, 120.0
"""s before the richer one is tried again; doubled each time that it did not last"""
LASTED_S = 20.0


class Rungs:
    """``at``: the stream, 0 for the richest of ``count``; ``key_only``: of it key frames only. Times: monotonic
    seconds.
    """

    def __init__(self, count: int, now: float) -> None:
        self.at = 0
        self.key_only = False
        self._count, self._changed = count, now
        self._short: float | None = None
        self._wait = FIRST_WAIT

    def choose(self, budget: float, needs: float, now: float) -> bool:
        """Whether another one is taken from now on. ``needs``: B/s of the whole stream that is taken now; 0: not
        known.
        """
        if not self.key_only and budget < FITS * needs:
            self._short = now if self._short is None else self._short
            if now - self._short < SHORT_S:
                return False
            self._step_down(now)
            return True
        self._short = None
        lasted = now - self._changed
        if not self.key_only and lasted > LASTED_S:
            self._wait = FIRST_WAIT
        if (self.key_only or self.at) and lasted > self._wait:
            if self.key_only:
                self.key_only = False
            else:
                self.at -= 1
            self._changed = now
            return True
        return False

    def _step_down(self, now: float) -> None:
        if now - self._changed < LASTED_S:
            self._wait = min(2.0 * self._wait, LONGEST_WAIT)
        if self.at + 1 < self._count:
            self.at += 1
        else:
            self.key_only = True
        self._short, self._changed = None, now
