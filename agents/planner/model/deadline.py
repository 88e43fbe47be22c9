"""When a search has to end: by the processor time of the thread that searches, and by the clock.

On a machine that does much else a search gets a share of the processor only, and is not to fail for that. Who waits
for it is not to wait without end either.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

WALL = 4.0
"""times its processor time a search may take by the clock"""


@dataclass(frozen=True)
class Deadline:
    """For the thread that made it: another one's processor time is another."""

    processor: float
    """s, of :func:`time.thread_time`"""
    wall: float
    """s, of :func:`time.monotonic`"""

    @classmethod
    def after(cls, seconds: float) -> Deadline:
        """``seconds`` of the processor from now on, and :data:`WALL` times as many by the clock."""
        return cls(time.thread_time() + seconds, time.monotonic() + WALL * max(seconds, 0.0))

    def within(self, seconds: float) -> Deadline:
        """This one, or ``seconds`` from now, whichever is earlier."""
        soon = Deadline.after(seconds)
        return Deadline(min(self.processor, soon.processor), min(self.wall, soon.wall))

    def later(self, seconds: float) -> Deadline:
        """This one after a wait of so long, which took nothing of the processor and does not count by the clock."""
        return Deadline(self.processor, self.wall + seconds)

    def left(self) -> float:
        """s of the processor; what the clock leaves where that is less. Negative when it is over."""
        return min(self.processor - time.thread_time(), self.wall - time.monotonic())

    @property
    def over(self) -> bool:
        return self.left() <= 0.0


NEVER = Deadline(math.inf, math.inf)
