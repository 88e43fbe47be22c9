"""Looks for a way home that is clear: which landing place, how high, and how late.

Everybody goes up where it rests, over the ground in a layer of its own above all that is flown, and down at a place
where nobody else lands. So most ways are clear of each other whenever each is flown; where a layer has to be crossed,
time decides. What is found is checked against all that anybody may do, so that nothing rests on how it was found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.returning.futures import Futures
from agents.planner.returning.ways import Pace, Way
from zmav.wire import Vector

LANDS_FROM = 4.0
"""m above its ground at which a way home ends, and the autopilot lands"""
DELAYS = (0.0, 4.0, 9.0, 15.0, 22.0, 30.0, 40.0, 55.0)
"""s after it may that a vehicle sets off, tried one after another"""
RINGS = 2
"""of landing places around a vehicle's home that are tried where that is not free"""
LONGEST = 900.0
"""s that a way home may last: a vehicle keeps no longer one"""
MOST_LAYERS, TRIED = 24, 6
"""layers there are at most, and those that are tried for one vehicle"""
MOST_TRIES = 100
"""ways at their times that are looked at for one vehicle: the others wait meanwhile"""
BENDS = (0.0, 0.25, -0.25, 0.6, -0.6, 1.2, -1.2)
"""shares of its length by which a level leg is bent aside at its middle, where something stands in its way"""
Clear = Callable[[Floats, Floats, float], bool]
"""is told both ends (ENU) of a straight piece and a radius: whether it is clear of all that stands, and inside"""


@dataclass(frozen=True)
class Returner:
    """One vehicle that flies home by itself."""

    home: Vector
    """ENU: where it took off, on the ground"""
    pace: Pace
    after: float
    """s from its segment's end until its way may begin"""
    lasts: float = math.inf
    """s from now until its battery must have brought it down"""


@dataclass(frozen=True)
class Surroundings:
    """What is the same for all."""

    clear: Clear
    movers: Sequence[MovingObstacle]
    """what moves or rests by itself and is in nobody's plan"""
    lowest: float
    """m up (ENU) from which layers are above all that is flown"""
    ceiling: float
    spacing: float
    """m between two layers"""


class Finder:
    """For one vehicle from one place: ``place`` (ENU), at rest, ``ready`` by our clock."""

    def __init__(
        self,
        vehicle: str,
        one: Returner,
        room: Surroundings,
        futures: Futures,
        need: float,
        *,
        others: Sequence[Vector],
        busy: Floats,
        late: float = 0.0,
    ) -> None:
        self._vehicle, self._one, self._room, self._futures, self._need = vehicle, one, room, futures, need
        self._others, self._busy, self._late = others, busy, late
        """homes of the others, which are left to them; (K, 2) ENU where others' plans go on; s that it follows late"""
        self.why = ""
        """why there is none"""

    def find(self, place: Floats, ready: float, now: float, layer: int, before: Floats | None = None) -> Way | None:
        """The way that is there first, or as good as that. ``layer``: the number of its own; ``before``: where it was
        to land last, which is kept where that is possible.
        """
        self.why = "no landing place, layer and time is free"
        most, tries = now + self._one.lasts, MOST_TRIES
        for pad in self._pads(before):
            for corners in self._corners(place, pad, layer):
                first = Way(corners, ready, self._one.pace, self._late)
                if first.ends > most:
                    self.why = f"the battery does not last {first.ends - now:.0f} s"
                    continue
                if first.ends - first.begins > LONGEST:
                    self.why = f"it would take {first.ends - first.begins:.0f} s"
                    continue
                if not self._stands_clear(corners):
                    continue
                if who := self._futures.below(self._vehicle, first, self._need):
                    self.why = f"it would pass below {who}, which may land"
                    continue
                for delay in DELAYS:
                    way = first.at(ready + delay)
                    if way.ends > most:
                        break
                    if tries == 0:
                        return None
                    tries -= 1
                    who = self._futures.in_the_way_of(self._vehicle, way, self._need, self._room.movers)
                    if who is None:
                        return way
                    self.why = f"{who} may be in its way"
        return None

    def _pads(self, before: Floats | None) -> list[Floats]:
        """Places on the ground, the best first: those that nobody's plan passes over."""
        places, apart = list(self._places(before)), 2.0 * self._need
        if not len(self._busy):
            return places
        flat = np.array(places)[:, None, :2] - self._busy[None]
        passed = np.hypot(flat[:, :, 0], flat[:, :, 1]).min(axis=1) < apart
        return [places[k] for k in np.argsort(passed, kind="stable")]

    def _places(self, before: Floats | None) -> Iterator[Floats]:
        x, y, z = self._one.home
        yield np.array([x, y, z])
        if before is not None and math.dist(before[:2], (x, y)) > 0.1:
            yield np.array([before[0], before[1], z])
        apart = 2.0 * self._need
        for ring in range(1, RINGS + 1):
            for k in range(6 * ring):
                angle, reach = math.tau * k / (6 * ring), 1.05 * ring * apart
                pad = np.array([x + reach * math.cos(angle), y + reach * math.sin(angle), z])
                if all(math.dist(pad[:2], other[:2]) >= apart for other in self._others):
                    yield pad

    def _corners(self, place: Floats, pad: Floats, layer: int) -> Iterator[Floats]:
        """Ways over the ground to the pad, in the vehicle's own layer first."""
        room = self._room
        count = min(MOST_LAYERS, math.floor((room.ceiling - room.lowest) / room.spacing) + 1)
        end = np.array([pad[0], pad[1], pad[2] + LANDS_FROM])
        for k in range(min(count, TRIED)):
            height = max(room.lowest + ((layer + k) % count) * room.spacing, float(place[2]))
            up, over = np.array([*place[:2], height]), np.array([*pad[:2], height])
            for bend in BENDS:
                aside = np.array([up[1] - over[1], over[0] - up[0], 0.0]) * bend
                middle = [0.5 * (up + over) + aside] if bend else []
                corners = np.array([place, up, *middle, over, end])
                if self._room.clear(up, corners[2], self._need) and (
                    not middle or self._room.clear(corners[2], over, self._need)
                ):
                    yield corners
                    break

    def _stands_clear(self, corners: Floats) -> bool:
        """Up and down; the legs between were looked at."""
        ends = ((corners[0], corners[1]), (corners[-2], corners[-1]))
        return all(self._room.clear(a, b, self._need) for a, b in ends)
