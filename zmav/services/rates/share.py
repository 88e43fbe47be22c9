"""What a link that is too narrow for everything carries: the least wanted is slowed first.

Plain arithmetic on what is wanted; :mod:`zmav.services.rates.rates` decides when to do it.
"""

from __future__ import annotations

from typing import NamedTuple

TRICKLE_HZ = 0.5
"""what every reader keeps, where even that fits or not: a value that is two seconds old beats none"""


class Want(NamedTuple):
    """One message that may be slowed."""

    name: str
    hz: float
    size: float
    """mean bytes a frame"""
    readers: int
    explicit: bool
    """somebody said the rate; False: it is only taken to be wanted at it"""

    @property
    def trickle(self) -> float:
        return min(self.hz, TRICKLE_HZ)


def share(wants: list[Want], room: float) -> dict[str, float]:
    """Rates in Hz that fit into ``room`` bytes a second.

    First everything gets its trickle, then the most wanted get what they want as long as it lasts: those with a rate of
    their own before others, those with more readers first, and of equals the cheaper, so that more of them stay whole.
    """
    left = room - sum(want.trickle * want.size for want in wants)
    rates = {}
    for want in sorted(wants, key=lambda w: (not w.explicit, -w.readers, w.hz * w.size, w.name)):
        more = min(want.hz - want.trickle, max(left, 0.0) / want.size)
        rates[want.name] = want.trickle + more
        left -= more * want.size
    return rates
