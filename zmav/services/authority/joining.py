"""Whether a vehicle is near enough to what it is to fly by the clock: a way that is checked begins where it is.

An autopilot that is given a far place flies there straight and as fast as it can, through anything that is between.
"""

from __future__ import annotations

import math

from zmav.services.authority.trajectory import Segment
from zmav.services.link.port import Port
from zmav.services.link.reported import FRESH, fields_of

JOIN_M, JOIN_S = 5.0, 1.0
"""m, and s of the segment's own speed, by which a vehicle may be away from where a segment has it when it joins it"""

Place = tuple[float, float, float]
"""degrees north and east, m above the sea"""


def place_of(port: Port, source: tuple[int, int]) -> Place | None:
    """Where the vehicle says that it is; None: it does not, or not lately."""
    here = fields_of(port, "GLOBAL_POSITION_INT", source, FRESH)
    return None if here is None else (here["lat"] / 1e7, here["lon"] / 1e7, here["alt"] / 1e3)


def why_not_joined(segment: Segment, t_utc: float, place: Place | None, *, flat: bool) -> str:
    """Why a vehicle that is at ``place`` may not join the segment at ``t_utc``; empty: it may. ``flat``: its height is
    nobody's choice, and does not count.
    """
    if place is None:
        return "where it is, is not known"
    away = segment.away(t_utc, place, flat=flat)
    near = JOIN_M + JOIN_S * math.hypot(*segment.local(t_utc)[1])
    return f"it is {away:.1f} m from where the segment has it now ({near:.1f} m at most)" if not away <= near else ""
