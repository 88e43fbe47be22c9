"""How far a vehicle's clock is ahead of ours, and how sure that is.

An answer that the vehicle stamped ``t`` between our question at ``asked`` and its arrival at ``came`` proves that its
clock is ahead by no less than ``t - came`` and no more than ``t - asked``; whatever it publishes with its time proves
the lower bound alone. All bounds are kept together, widened by how far two clocks may have drifted since: as NTP's
clock filter (RFC 5905, section 10), but with bounds in the place of weights, so that a delay that is all on one way
misleads nobody and only says less.
"""

from __future__ import annotations

import math

DRIFT = 100e-6
"""s a second two clocks may drift apart"""
FEW = 0.001
"""s by which stamps are uncertain by themselves"""


class Offset:
    """Vehicle's clock minus ours, seconds. ``value`` is what times are converted by: it stays as it was first taken for
    as long as it can be right, for a trajectory must not jump while it is flown.
    """

    def __init__(self) -> None:
        self._low, self._high = -math.inf, math.inf
        self._at = -math.inf
        self.value = 0.0
        self._fixed = False

    def answered(self, asked: float, t: float, came: float) -> None:
        """A question asked and its answer's arrival by our clock, stamped ``t`` by the vehicle's."""
        if came >= asked:
            self._take(t - came - FEW, t - asked + FEW, came)

    def heard(self, t: float, came: float) -> None:
        """Something stamped ``t`` came at ``came``."""
        self._take(t - came - FEW, math.inf, came)

    def _take(self, low: float, high: float, now: float) -> None:
        self._widen(now)
        low, high = max(low, self._low), min(high, self._high)
        if low > high:  # one of the clocks was set: what was known is no more
            self._low, self._high = -math.inf, math.inf
        else:
            self._low, self._high = low, high
        self._at = now
        if not self._fixed:
            self._settle()

    def _settle(self) -> None:
        if math.isfinite(self._low) and math.isfinite(self._high):
            self.value = 0.5 * (self._low + self._high)

    def _widen(self, now: float) -> None:
        if math.isfinite(self._at) and now > self._at:
            self._low -= DRIFT * (now - self._at)
            self._high += DRIFT * (now - self._at)
            self._at = now

    def fix(self) -> None:
        """From now on times are converted by the present ``value``."""
        self._settle()
        self._fixed = True

    def free(self) -> None:
        """Nothing flies by it any more: ``value`` is what is known best again."""
        self._fixed = False
        self._settle()

    def error(self, now: float) -> float:
        """Seconds by which ``value`` may be wrong; inf while too little is known."""
        if not math.isfinite(self._at):
            return math.inf
        return max(self._high - self.value, self.value - self._low) + DRIFT * max(0.0, now - self._at)

    def vehicle(self, t: float) -> float:
        """Our time as the vehicle's."""
        return t + self.value

    def ours(self, t: float) -> float:
        """The vehicle's time as ours."""
        return t - self.value
