"""What the vehicle flies, and for whom: a point that is renewed, or a segment of a trajectory."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from zmav.autopilots import Autopilot, Target
from zmav.services.authority.trajectory import Segment

SEGMENT_AHEAD = 0.07
"""s by which a point of a segment is given early: half the time between two, and what link and autopilot take"""


class ActiveStream(NamedTuple):
    """What the vehicle flies, and for whom."""

    autopilot: Autopilot
    source: tuple[int, int]
    lease: int
    """its lease's number"""
    what: Target | Segment
    mode: str
    """the mode that follows it"""
    until: float
    """monotonic seconds at which it is stale unless renewed"""
    goes_on: bool = True
    """an action follows its hold; not where its end was meant"""


def future(flown: ActiveStream) -> Callable[[float], Target]:
    """What is to be flown so many seconds from now. Of a segment, by the clock it was accepted by: UTC may be set."""
    what, now = flown.what, time.monotonic()
    if isinstance(what, Segment):
        return lambda ahead: what.at(what.end - (flown.until - now) + SEGMENT_AHEAD + ahead)
    return lambda ahead: what
