"""What may leave through a radio: the fleet file's budget, and the token bucket that keeps it."""

from __future__ import annotations

from mesh.units import bits_per_second
from zmav.errors import BadConfig, BadInput

LEAST = 5000.0
"""bytes/s below which no router's link opens in time (measured: 1.3 s at 5 kB/s)"""
LARGEST = 1500
"""bytes of a datagram with its IP and UDP headers, as Ethernet carries it"""
BURST = 0.04
"""s of the budget that may leave at once after a silence: no second holds more than 5 % above the budget"""


def parse_budget(text: str, field: str = "budget") -> float:
    """Bytes a second of ``60 kB/s`` or ``1 Mbit/s``; raises :class:`BadConfig` for anything else."""
    expected = "like '60 kB/s' or '1 Mbit/s', 5 kB/s at least"
    try:
        rate = bits_per_second(text, field) / 8.0 if text.rstrip().endswith("/s") else 0.0
    except BadInput:
        rate = 0.0
    if rate < LEAST:
        raise BadConfig(f"{field} is {text!r}; expected {expected}", field=field, value=text, expected=expected)
    return rate


class Bucket:
    """A token bucket: tokens are bytes, come at ``rate`` a second, and ``depth`` of them are kept at most.

    What leaves in any ``t`` seconds is at most ``rate * t + depth``, where no single datagram is larger than ``depth``.
    """

    def __init__(self, rate: float, now: float) -> None:
        self.rate = rate
        self.depth = max(BURST * rate, float(LARGEST))
        self._tokens, self._at = self.depth, now

    def take(self, size: int, now: float) -> bool:
        """Take ``size`` bytes' tokens if they are there; a larger datagram than the bucket waits for a full one."""
        self._fill(now)
        if self._tokens < min(size, self.depth):
            return False
        self._tokens -= size
        return True

    def wait(self, size: int, now: float) -> float:
        """Seconds until :meth:`take` will give so many."""
        self._fill(now)
        return max(min(size, self.depth) - self._tokens, 0.0) / self.rate

    def _fill(self, now: float) -> None:
        self._tokens = min(self._tokens + self.rate * max(now - self._at, 0.0), self.depth)
        self._at = max(now, self._at)
