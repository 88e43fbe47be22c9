"""The way home that a vehicle has stored: sent with the segment that it is on, and flown if nothing else comes.

A planner sends one only where it is clear of everything that any other vehicle may do then (docs/planner-return.md), so
it is begun at its time and from its place, or not at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav import wire
from zmav.config import RETURN_LEAD
from zmav.errors import BadInput
from zmav.services.authority.joining import place_of
from zmav.services.authority.trajectory import Segment
from zmav.services.link.port import Port

JOINS = 0.5
"""m from its segment's end at which a way home begins at most"""
NEAR = 2.0
"""m from where the way begins at which the vehicle must be when it is to be flown"""
LATE = 0.5
"""s after its beginning at which that mode must be there"""
MOST_WAIT, MOST_LASTING = 300.0, 900.0
"""s later than it must that a way may begin, and that it may last"""


class StoredReturn(NamedTuple):
    """What follows a segment, the segment's hold and ``land_after``."""

    way: Segment
    begins: float
    """monotonic seconds"""

    @property
    def ends(self) -> float:
        return self.begins + self.way.end - self.way.start

    def missed(self, now: float, port: Port, source: tuple[int, int], *, flat: bool) -> str:
        """Why it cannot be flown any more from where the vehicle is; empty: it can. ``flat``: at any height."""
        if now > self.begins - RETURN_LEAD + LATE:
            return f"it was to begin {now - self.begins:.0f} s ago"
        if (place := place_of(port, source)) is None:
            return "where it is, is not known"
        away = self.way.away(self.way.start, place, flat=flat)
        return f"it begins {away:.1f} m from here" if not away <= NEAR else ""


def read_way_home(home: wire.WayHome, segment: Segment, after: float, utc: float, now: float) -> StoredReturn:
    """What came with ``segment`` at ``utc``, which is ``now`` by the monotonic clock. ``after``: s from a segment's end
    until one may begin.

    Raises :class:`BadInput` for a way that does not go on from there, begins too soon or too late, or is none.
    """
    soonest = segment.end + after
    if not soonest <= home.start <= soonest + MOST_WAIT:
        text = f"home.start is {home.start - segment.end:.1f} s after the segment's end"
        raise BadInput(text, field="home.start", value=home.start, expected=f"{after:g} to {after + MOST_WAIT:g} s")
    points = [wire.SegmentPoint(t=home.start + t, pos=pos, vel=vel) for t, pos, vel in home.points]
    if not home.points or home.points[0][0] != 0.0 or not home.points[-1][0] <= MOST_LASTING:
        lasts = home.points[-1][0] if home.points else None
        text = f"home.points begin at 0 and last {MOST_LASTING:.0f} s at most"
        raise BadInput(text, field="home.points", value=lasts, expected=f"0 to {MOST_LASTING:.0f}")
    way = Segment(points, segment.origin, home.start)
    away = math.dist(way.local(way.start)[0], segment.local(segment.end)[0])
    if not away <= JOINS:
        text = f"home.points begin {away:.1f} m from the segment's end"
        raise BadInput(text, field="home.points", value=away, expected=f"{JOINS:g} m or less")
    return StoredReturn(way, now + home.start - utc)
