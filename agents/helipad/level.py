"""How far down the pad is: what is said of it, put right by how large the pad appears.

What is said comes from two autopilots' heights, which differ by half a metre or more. At 1 m above the pad that is half
of the height, and a search at so wrong a height finds nothing.
"""

from __future__ import annotations

import math

UNKNOWN, MOST = 1.0, 2.0
"""m: standard deviation of the level that is said; and by how much it is wrong at most: the rest is no pad"""
DRIFT = 0.1
"""m per root of a second: how fast that error changes"""
SHARED = 0.5
"""of a size's deviation: what all pictures share, so that many of them make it no smaller"""
FORGOTTEN = 10.0
"""s without a sight after which what is said counts again"""
GATE, STRAYS = 3.0, 4
"""standard deviations beyond which a size is not believed; such sizes in a row after which it is learned afresh"""


class PadLevel:
    """A scalar Kalman filter of the error of what is said, m. Used from one thread at a time."""

    def __init__(self) -> None:
        self._t = float("-inf")
        self._off = 0.0
        self._variance = UNKNOWN**2
        self._strays = 0

    def at(self, t: float, said: float) -> float:
        """m down at ``t`` (s), where ``said`` is what is said."""
        return said + (self._off if 0.0 <= t - self._t < FORGOTTEN else 0.0)

    def learn(self, t: float, said: float, sized: float, deviation: float) -> None:
        """The pad's size in a picture taken at ``t`` says ``sized``; ``deviation``: its standard deviation, m."""
        if not abs(sized - said) <= MOST:
            return
        since = t - self._t
        if not 0.0 <= since < FORGOTTEN:
            self._off, self._variance, self._strays, since = 0.0, UNKNOWN**2, 0, 0.0
        variance = self._variance + DRIFT**2 * since
        noise = deviation**2
        wrong = sized - said - self._off
        if abs(wrong) > GATE * math.sqrt(variance + noise):
            self._strays += 1
            if self._strays < STRAYS:
                return
            variance = UNKNOWN**2
        self._strays = 0
        gain = variance / (variance + noise)
        self._off += gain * wrong
        self._variance = max((1.0 - gain) * variance, SHARED**2 * noise)
        self._t = t
