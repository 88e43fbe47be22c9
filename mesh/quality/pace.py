"""How often a neighbour is probed: seldom enough that nobody notices."""

from __future__ import annotations

from dataclasses import dataclass

from mesh.quality.stamp import TRAIN_SIZE
from mesh.quality.throughput import OVERHEAD

STAMP_BYTES = 124
"""of a stamp on the wire, IP and UDP headers included, measured over ``udp/``"""
PAIR = 2
"""messages of the shortest train there can be"""


@dataclass(frozen=True)
class Pace:
    """What probes may cost. With one neighbour and no budget: 0.5 kB/s of stamps and 0.3 kB/s of trains each way."""

    period: float = 0.25
    """s between stamps at best"""
    slowest: float = 5.0
    """s between stamps at worst"""
    per_host: float = 24.0
    """stamps a second to all neighbours together"""
    share: float = 0.01
    """of a budget, for stamps to all neighbours, and as much for trains"""
    train: int = 8
    """messages of a train: no more than QUIC sends at once on a link it knows nothing of yet (RFC 9002: ten)"""
    train_every: float = 30.0
    """s between trains, times the number of neighbours"""
    train_part: float = 0.1
    """s of a link's time that a train may take, because a setpoint may have to wait for as long"""

    def stamps(self, neighbours: int, budget: float | None) -> float:
        """s between stamps to each of so many neighbours over a link with a budget in bytes/s."""
        often = max(self.period, neighbours / self.per_host)
        if budget:
            often = max(often, neighbours * STAMP_BYTES / (self.share * budget))
        return min(often, self.slowest)

    def trains(self, neighbours: int, budget: float | None, rate: float | None = None) -> tuple[int, float]:
        """Messages of a train, zero for none at all, and s between trains; ``rate``: bytes/s that were measured.

        Two messages where neither a budget nor a rate says what the link can take, or where it takes no more.
        """
        neighbours, size, known = max(neighbours, 1), TRAIN_SIZE + OVERHEAD, budget or rate
        every = self.train_every * neighbours
        if not known:
            return min(PAIR, self.train), every
        count = min(self.train, int(self.train_part * known / size))
        if count < PAIR + 1:
            if budget:
                return 0, every  # the budget says what there is, and finding out would take too much of it
            count = min(PAIR, self.train)
        return count, max(every, neighbours * count * size / (self.share * known))
