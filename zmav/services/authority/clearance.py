"""How far above the ground a vehicle may be led, by the pieces of ground that it keeps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from zmav import geo
from zmav.errors import BadInput
from zmav.terrain import Ground

STEP, MOST = 20.0, 1000
"""m between two places of a straight way that are looked at, and of those at most so many"""
USUAL = -10.0
"""m: SRTM may be wrong by that, so without a declared clearance only what lies deeper is refused"""
MOST_OFFSET = 30.0
"""m by which the place where it stood may be above or below the ground that is known there, as ArduPilot's
TERRAIN_OFS_MAX"""
EDGE = 0.5
"""m: a way that is level over level ground is no lower than it was"""
LEAVES = 50.0
"""m over the ground from where a vehicle is that is lower than is declared: within them it climbs away"""
FORCE = "; an operator's order with force (--force) passes once"
COLUMN = 3.0
"""m over the ground from where a way ends to land: there it may come down"""


class Place(NamedTuple):
    lat_deg: float
    lon_deg: float
    alt_amsl: float


class Clearance:
    """Judges places and straight ways. From any thread.

    Heights of the ground are moved by what they are off where the vehicle ``stood``, when it was armed. ``declared``:
    metres above the ground that the fleet file asks for; with it what is not known is refused too. None: only what is
    surely in the ground is refused, and an operator's ``force`` passes.
    """

    def __init__(self, ground: Ground, declared: float | None) -> None:
        self._ground, self._declared = ground, declared

    @property
    def judges(self) -> bool:
        """There is anything to judge by."""
        return self._declared is not None or not self._ground.empty

    def check(self, goal: Place, start: Place | None, stood: Place | None, *, force: bool | None) -> None:
        """Raise :class:`~zmav.errors.BadInput` where ``goal`` is too low, or the way from ``start`` gets there: lower
        than is asked for and than the vehicle is at its start.
        """
        if self._declared is None and force:
            return
        offset = self._offset(stood)
        on_way = self._least if start is None else self._as_low_as(start, offset)
        for place in (goal,) if start is None else (*_between(start, goal), goal):
            above = self._above(place, offset)
            if above is not None and above < (self._least if place is goal else on_way):
                raise self._too_low(place, above, force)

    def check_way(self, places: Iterable[Place], here: Place | None, stood: Place | None, *, lands: bool) -> None:
        """Raise :class:`~zmav.errors.BadInput` where the way leads too low: lower than is asked for, than the vehicle
        is ``here`` and than it has got by then. So one that is too low may climb away; beyond :data:`LEAVES` it has to
        be as high as is declared. ``lands``: at the way's end it may come down.
        """
        offset, way = self._offset(stood), list(places)
        least, end = self._least if here is None else self._as_low_as(here, offset), way[-1]
        for place in way:
            above = self._above(place, offset)
            if above is None:
                continue
            down = lands and geo.horizontal_distance(*place[:2], *end[:2]) <= COLUMN
            away = self._declared is not None and here and geo.horizontal_distance(*here[:2], *place[:2]) > LEAVES
            if above < (USUAL if down else self._least - EDGE if away else least):
                raise self._too_low(place, above, None)
            least = max(least, min(self._least, above - EDGE))

    def above(self, place: Place, stood: Place | None) -> float | None:
        """m above the ground; None where that is not known, which is refused where the fleet file declares a
        clearance.
        """
        return self._above(place, self._offset(stood))

    def above_sea(self, lat_deg: float, lon_deg: float, height: float, stood: Place | None) -> float | None:
        """What a height above the ground is above the sea; None where the ground is not known, which is refused where
        the fleet file declares a clearance.
        """
        ground = self._ground.height(lat_deg, lon_deg)
        if ground is not None:
            return ground + self._offset(stood) + height
        if self._declared is not None:
            raise self._unknown(Place(lat_deg, lon_deg, math.nan))
        return None

    @property
    def _least(self) -> float:
        return USUAL if self._declared is None else self._declared

    def _as_low_as(self, start: Place, offset: float) -> float:
        """How low a way may be that begins there, which may be too low already, or where the ground is not known."""
        ground = self._ground.height(start.lat_deg, start.lon_deg)
        return self._least if ground is None else min(self._least, start.alt_amsl - ground - offset - EDGE)

    def _above(self, place: Place, offset: float) -> float | None:
        """m above the ground; None where that is not known and need not be."""
        ground = self._ground.height(place.lat_deg, place.lon_deg)
        if ground is None and self._declared is not None:
            raise self._unknown(place)
        return None if ground is None else place.alt_amsl - ground - offset

    def _offset(self, stood: Place | None) -> float:
        ground = None if stood is None else self._ground.height(stood.lat_deg, stood.lon_deg)
        return 0.0 if stood is None or ground is None else offset_of(stood.alt_amsl - ground)

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
        hint = FORCE if force is False else ""
        return BadInput(text + hint, field="pos", value=above, expected="above the ground", count="ground")


def offset_of(above: float) -> float:
    """m by which the ground that is known is too low, where a vehicle on the ground is so high above it."""
    return min(max(above, -MOST_OFFSET), MOST_OFFSET)


def _between(start: Place, goal: Place) -> Iterator[Place]:
    """Places of the straight way, without its ends."""
    east = geo.wrap_degrees(goal.lon_deg - start.lon_deg)
    north = goal.lat_deg - start.lat_deg
    steps = min(math.ceil(geo.horizontal_distance(*start[:2], *goal[:2]) / STEP), MOST)
    for i in range(1, steps):
        share = i / steps
        up = goal.alt_amsl - start.alt_amsl
        yield Place(start.lat_deg + share * north, start.lon_deg + share * east, start.alt_amsl + share * up)
