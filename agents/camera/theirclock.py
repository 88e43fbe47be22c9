"""Times by a clock that is not ours, as a simulator's that falls behind: set right where they cannot be of ours.

By the least delay of the last few seconds, as network clocks do it (Cristian 1989): nothing comes before it was sent,
and now and then something comes at once.
"""

from __future__ import annotations

from collections import deque

LATE, EARLY = 0.02, -0.005
"""s from exposure to arrival, at the least, beyond which the two clocks are not one"""
USUAL = 0.008
"""s that it takes at the least where they are not: to be rendered or read out, and handed over"""
WINDOW = 5.0
"""s of arrivals that are looked at"""


class TheirClock:
    """One source's."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()

    def ours(self, t: float, arrived: float) -> float:
        """``t`` (UTC s by their clock) of what ``arrived`` (UTC s by ours), by our clock."""
        delays = self._delays
        delays.append((arrived, arrived - t))
        while delays[0][0] < arrived - WINDOW or delays[0][0] > arrived:
            delays.popleft()
        least = min(delay for _, delay in delays)
        return t if EARLY <= least <= LATE else t + least - USUAL
