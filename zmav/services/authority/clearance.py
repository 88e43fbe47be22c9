"""How far above the ground a vehicle may be led, by the pieces of ground that it keeps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from zmav.errors import BadInput
from zmav.terrain import Ground

STEP, MOST = 20.0, 1000
"""m between two places of a straight way that are looked at, and of those at most so many"""
METRES = 111_320.0
"""in a degree of latitude, near enough to say how many places a way has"""
USUAL = -10.0
"""m: SRTM may be wrong by that, so without a declared clearance only what lies deeper is refused"""
MOST_OFFSET = 30.0
"""m by which home may be above or below the ground that is known there, as ArduPilot's TERRAIN_OFS_MAX"""
EDGE = 0.5
"""m: a way that is level over level ground is no lower than it was"""


class Place(NamedTuple):
    lat_deg: float
    lon_deg: float
    alt_amsl: float


class Clearance:
    """Judges places and straight ways. From any thread.

    Heights of the ground are moved by what they are off at home, which is where the vehicle stood. ``declared``: metres
    above the ground that the fleet file asks for; with it what is not known is refused too. None: only what is surely
    in the ground is refused, and an operator's ``force`` passes.
    """

    def __init__(self, ground: Ground, declared: float | None) -> None:
        self._ground, self._declared = ground, declared

    @property
    def judges(self) -> bool:
        """There is anything to judge by."""
        return self._declared is not None or not self._ground.empty

    def check(self, goal: Place, start: Place | None, home: Place | None, *, force: bool | None) -> None:
        """Raise :class:`~zmav.errors.BadInput` where ``goal`` is too low, or the way from ``start`` gets there: lower
        than is asked for and than the vehicle is at its start.
        """
        if self._declared is None and force:
            return
        least = USUAL if self._declared is None else self._declared
        offset = self._offset(home)
        on_way = least if start is None else min(least, self._above(start, offset, least) - EDGE)
        for place in (goal,) if start is None else (*_between(start, goal), goal):
            ground = self._ground.height(place.lat_deg, place.lon_deg)
            if ground is None:
                if self._declared is not None:
                    raise self._unknown(place)
                continue
            above = place.alt_amsl - ground - offset
            if above < (least if place is goal else on_way):
                raise self._too_low(place, above, force)

    def above_sea(self, lat_deg: float, lon_deg: float, height: float, home: Place | None) -> float | None:
        """What a height above the ground is above the sea; None where the ground is not known, which is refused where
        the fleet file declares a clearance.
        """
        ground = self._ground.height(lat_deg, lon_deg)
        if ground is not None:
            return ground + self._offset(home) + height
        if self._declared is not None:
            raise self._unknown(Place(lat_deg, lon_deg, math.nan))
        return None

    def _above(self, place: Place, offset: float, otherwise: float) -> float:
        ground = self._ground.height(place.lat_deg, place.lon_deg)
        return otherwise if ground is None else place.alt_amsl - ground - offset

    def _offset(self, home: Place | None) -> float:
        ground = None if home is None else self._ground.height(home.lat_deg, home.lon_deg)
        if home is None or ground is None:
            return 0.0
        return min(max(home.alt_amsl - ground, -MOST_OFFSET), MOST_OFFSET)

    def _unknown(self, place: Place) -> BadInput:
        text = (
            f"the ground at {place.lat_deg:.5f}, {place.lon_deg:.5f} is not known here, and the fleet file asks for "
            f"{self._declared:g} m above it: 'zmav terrain load'"
        )
        return BadInput(text, field="pos", value=None, expected="ground that is known", count="ground")

    def _too_low(self, place: Place, above: float, force: bool | None) -> BadInput:
        where = f"{above:.1f} m above the ground" if above >= 0.0 else f"{-above:.1f} m under the ground"
        text = f"pos: {where} at {place.lat_deg:.5f}, {place.lon_deg:.5f}"
        if self._declared is not None:
            expected = f"at least {self._declared:g} m above the ground"
            return BadInput(f"{text}; expected {expected}", field="pos", value=above, expected=expected, count="ground")
        hint = "; an operator's order with force (--force) passes once" if force is False else ""
        return BadInput(text + hint, field="pos", value=above, expected="above the ground", count="ground")


def _between(start: Place, goal: Place) -> Iterator[Place]:
    """Places of the straight way, without its ends."""
    east = (goal.lon_deg - start.lon_deg + 180.0) % 360.0 - 180.0
    north = goal.lat_deg - start.lat_deg
    length = METRES * math.hypot(north, east * math.cos(math.radians(goal.lat_deg)))
    steps = min(math.ceil(length / STEP), MOST)
    for i in range(1, steps):
        share = i / steps
        up = goal.alt_amsl - start.alt_amsl
        yield Place(start.lat_deg + share * north, start.lon_deg + share * east, start.alt_amsl + share * up)
