"""One way of dealing a search out: the ground cut into parts that take each vehicle the same time.

A rough model of what a part takes gives the cuts; the lanes laid over the parts give the true times, which correct the
model, a few times over.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from agents.planner.goals.curves import rounded
from agents.planner.goals.detour import HUG, Detours
from agents.planner.goals.lanes import lanes_over, tour
from agents.planner.model.problem import Floats, Path

STEP = 0.2
"""m"""
ROUNDING = 0.2
"""radius of a turn between lanes, of the lanes' width: more would leave corners unseen"""
SLICES = 400
"""of the polygon, for the share of it that lies below a cut"""
ROUNDS = 6
"""in which the parts' sizes follow the times that their lanes take"""


BAND_ROUNDS = 3
"""in which the bands' sizes follow the times that their parts take"""
TURNING = 1.2
"""a plane's turn radii that are left free around the ends of its lanes"""


@dataclass(frozen=True)
class Sweeper:
    """One vehicle, as a search sees it; metres, seconds."""

    name: str
    start: Floats
    """(3,) ENU: where it is now, and comes back to"""
    height: float
    """at which it sweeps"""
    width: float
    """of ground seen on one pass"""
    speed: float
    accel: float
    climb: float
    endurance: float
    radius: float
    turn_radius: float = 0.0
    """0: it turns where it stands"""


@dataclass(frozen=True)
class Ground:
    """What is to be seen and where vehicles may be meanwhile: shapely areas."""

    wanted: Any
    free: Any


@dataclass(frozen=True)
class Part:
    """What one vehicle does."""

    sweeper: Sweeper
    area: Any
    path: Path
    """(K, 3) ENU corners of its way over its part; no rows: nothing is left for it"""
    seconds: float
    """from its start over all of the path back to its start"""

    def curve(self, free: Any) -> Path:
        """(M, 3) the way as it is flown, with its corners rounded where there is room."""
        if len(self.path) < 2:
            return self.path
        radius = ROUNDING * self.sweeper.width
        return rounded(self.path, radius, STEP, cut=0.45 * radius, area=free)

    def seen(self, free: Any) -> Any:
        """The ground that its strips cover."""
        curve = self.curve(free)
        if len(curve) < 2:
            return shapely.Polygon()
        line = shapely.simplify(shapely.linestrings(curve[:, :2]), 0.02)
        return shapely.buffer(line, self.sweeper.width / 2.0, cap_style="flat", quad_segs=8)


class Dealer:
    """The ground turned so that lanes run along x, and the vehicles with it."""

    def __init__(self, area: Ground, sweepers: Sequence[Sweeper], overlap: float, angle: float) -> None:
        def turn(shape: Any) -> Any:
            return affinity.rotate(shape, -angle, origin=(0.0, 0.0), use_radians=True)

        self._angle, self._overlap, self._sweepers = angle, overlap, list(sweepers)
        self._wanted, self._free = turn(area.wanted), turn(area.free)
        self._ways = Detours(self._free)
        self._lanes = self._free.buffer(-HUG, join_style="mitre")
        self._middle: tuple[float, float] = self._wanted.centroid.coords[0]
        cos, sin = math.cos(angle), math.sin(angle)
        self._back = np.array([[cos, sin], [-sin, cos]])
        """points of rows times this are points in the world"""
        self._starts = np.array([s.start[:2] for s in sweepers]) @ self._back.T

    def deal(self, along: bool) -> list[Part] | None:
        """Parts in the sweepers' order; ``along``: cut across x, else across y. None where lanes cannot be joined."""
        axis = 0 if along else 1
        places, below, extents = self._profile(axis)
        order = np.argsort(self._starts[:, axis], kind="stable")
        factors = np.ones(len(order))
        corner = 0 if along else None
        best: list[Part] | None = None
        for _ in range(ROUNDS):
            cuts = self._cuts(order, factors, places, below, extents, along)
            parts: list[Part | None] = [None] * len(order)
            expected = []
            for k, i in enumerate(order):
                part = self._part(int(i), axis, cuts[k], cuts[k + 1], corner)
                if part is None:
                    return best
                parts[i] = part
                expected.append(self._model(int(i), k, cuts, places, below, extents, along))
            made = [part for part in parts if part is not None]
            if best is None or _rank(made) < _rank(best):
                best = made
            taken = np.array([made[i].seconds for i in order])
            change = np.where(taken > 0.0, taken / np.maximum(expected, 1e-6), 1.0)
            if np.abs(change / factors - 1.0).max() < 0.01:
                break
            factors = 0.3 * factors + 0.7 * change
        return best

    def banded(self, bands: int) -> list[Part] | None:
        """Parts as :meth:`deal`'s along the lanes, in so many bands, each dealt out among some of the vehicles.

        Where there are few lanes for each vehicle a part need not be whole ones then. None where a band has no parts.
        """
        groups = np.array_split(np.argsort(self._starts[:, 1], kind="stable"), bands)
        places, below, _ = self._profile(1)
        weights = np.array([sum(self._sweepers[i].width * self._sweepers[i].speed for i in group) for group in groups])
        left, _, right, _ = self._wanted.bounds
        best: list[Part] | None = None
        for _ in range(BAND_ROUNDS):
            shares = np.concatenate(([0.0], np.cumsum(weights) / weights.sum()))
            cuts = np.interp(shares * below[-1], below, places)
            parts: list[Part] = [Part(sweeper, shapely.Polygon(), np.zeros((0, 3)), 0.0) for sweeper in self._sweepers]
            lasts = []
            for group, low, high in zip(groups, cuts[:-1], cuts[1:], strict=True):
                band = copy.copy(self)
                band._wanted = self._wanted.intersection(shapely.box(left - 1.0, low, right + 1.0, high))
                band._sweepers, band._starts = [self._sweepers[i] for i in group], self._starts[group]
                if band._wanted.area < 1.0:
                    return best
                band._middle = band._wanted.centroid.coords[0]
                dealt = band.deal(along=True)
                if dealt is None:
                    return best
                for i, part in zip(group, dealt, strict=True):
                    parts[i] = part
                lasts.append(max(part.seconds for part in dealt))
            if best is None or _rank(parts) < _rank(best):
                best = parts
            weights = weights * np.mean(lasts) / np.maximum(lasts, 1e-6)
        return best

    def _profile(self, axis: int) -> tuple[Floats, Floats, Floats]:
        """Cuts, the area below each, and how far the area reaches across the cut there."""
        left, bottom, right, top = self._wanted.bounds
        low, high = (left, right) if axis == 0 else (bottom, top)
        places = np.linspace(low, high, SLICES + 1)
        if axis == 0:
            boxes = shapely.box(places[:-1], bottom - 1.0, places[1:], top + 1.0)
        else:
            boxes = shapely.box(left - 1.0, places[:-1], right + 1.0, places[1:])
        slices = shapely.area(shapely.intersection(self._wanted, boxes))
        return places, np.concatenate(([0.0], np.cumsum(slices))), slices / (places[1] - places[0])

    def _seconds(self, i: int, area: float, extent: float, deep: float, along: bool) -> float:
        """What a part of so much area takes vehicle i, roughly: flying, turning, and both ways."""
        sweeper = self._sweepers[i]
        width = sweeper.width * (1.0 - self._overlap)
        rows = extent / width if along else deep / width
        return area / (width * sweeper.speed) + rows * _turn_time(sweeper, width)

    def _model(
        self, i: int, k: int, cuts: Floats, places: Floats, below: Floats, extents: Floats, along: bool
    ) -> float:
        low, high = float(cuts[k]), float(cuts[k + 1])
        slice_of = SLICES / float(places[-1] - places[0])
        first, last = (min(SLICES, max(0.0, (at - float(places[0])) * slice_of)) for at in (low, high))
        area = _between(below, last) - _between(below, first)
        reached = extents[int(first) : max(int(first) + 1, math.ceil(last - 1e-6))]
        extent = float(reached.max()) if along and high > low else 0.0
        return self._seconds(i, area, extent, high - low, along) + self._away(i, along, (low + high) / 2.0)

    def _away(self, i: int, along: bool, cut: float) -> float:
        """Seconds to a part about ``cut`` and back."""
        sweeper = self._sweepers[i]
        x, y = (cut, self._middle[1]) if along else (self._middle[0], cut)
        level = math.hypot(float(self._starts[i, 0]) - x, float(self._starts[i, 1]) - y)
        rise = abs(sweeper.height - float(sweeper.start[2]))
        return 2.0 * (max(level / sweeper.speed, rise / sweeper.climb) + sweeper.speed / sweeper.accel)

    def _cuts(self, order: Any, factors: Floats, places: Floats, below: Floats, extents: Floats, along: bool) -> Floats:
        """(N + 1,) cuts such that all parts take the same time by the model, times each vehicle's factor."""

        def run(limit: float) -> Floats:
            cuts = [float(places[0])]
            for k, i in enumerate(order):
                cap = min(limit, self._sweepers[i].endurance)
                low, high = cuts[-1], float(places[-1])
                for _ in range(14):
                    middle = (low + high) / 2.0
                    trial = np.array([cuts[-1], middle])
                    seconds = self._model(int(i), 0, trial, places, below, extents, along)
                    low, high = (middle, high) if seconds * factors[k] <= cap else (low, middle)
                if high >= places[-1] - 1e-9:
                    low = float(places[-1])
                cuts.append(low)
            return np.array(cuts)

        least, most = 0.0, max(sweeper.endurance for sweeper in self._sweepers)
        end = float(places[-1]) - 1e-3 * float(places[-1] - places[0])
        if run(most)[-1] < end:
            return run(most)
        for _ in range(14):
            middle = (least + most) / 2.0
            least, most = (least, middle) if run(middle)[-1] >= end else (middle, most)
        cuts = run(most)
        cuts[-1] = places[-1]
        return cuts

    def _part(self, i: int, axis: int, low: float, high: float, corner: int | None) -> Part | None:
        """Vehicle i's lanes between two cuts."""
        sweeper = self._sweepers[i]
        left, bottom, right, top = self._wanted.bounds
        box = shapely.box(low, bottom, high, top) if axis == 0 else shapely.box(left, low, right, high)
        area = self._wanted.intersection(box)
        lanes = []
        if high > low:
            free = self._lanes.buffer(-TURNING * sweeper.turn_radius) if sweeper.turn_radius > 0.0 else self._lanes
            lanes = lanes_over(area, sweeper.width * (1.0 - self._overlap), free)
        if not lanes:
            return Part(sweeper, shapely.Polygon(), np.zeros((0, 3)), 0.0)
        level = tour(lanes, self._starts[i], self._ways, corner, sweeper.turn_radius)
        if level is None:
            return None
        flat = level @ self._back
        path = np.column_stack((flat, np.full(len(flat), sweeper.height)))
        world = affinity.rotate(area, self._angle, origin=(0.0, 0.0), use_radians=True)
        return Part(sweeper, world, path, seconds_of(path, sweeper))


def _between(values: Floats, at: float) -> float:
    """The value at a place between two, on a straight line."""
    k = min(int(at), len(values) - 2)
    return float(values[k]) + (at - k) * float(values[k + 1] - values[k])


def _rank(parts: list[Part]) -> tuple[float, float]:
    """Those that break an endurance last; then the earliest end."""
    over = max(max(0.0, part.seconds / part.sweeper.endurance - 1.0) for part in parts)
    return (round(over, 3), max(part.seconds for part in parts))


def _turn_time(sweeper: Sweeper, width: float) -> float:
    """Seconds that the turn from one lane to the next costs beside the sweeping."""
    if sweeper.turn_radius > 0.0:
        return math.pi * sweeper.turn_radius / sweeper.speed
    return width / sweeper.speed + 2.0 * _corner_time(sweeper, math.pi / 2.0)


def _corner_time(sweeper: Sweeper, turn: float) -> float:
    """Seconds lost by slowing down for a corner and speeding up again."""
    if turn < 0.05:
        return 0.0
    slow = min(sweeper.speed, math.sqrt(0.7 * sweeper.accel * ROUNDING * sweeper.width))
    if turn > 3.0:
        slow = 0.0
    return (sweeper.speed - slow) ** 2 / (sweeper.accel * sweeper.speed)


def seconds_of(path: Path, sweeper: Sweeper) -> float:
    """From the vehicle's start over the path and back to its start."""
    pieces = np.diff(path, axis=0)
    lengths = np.linalg.norm(pieces, axis=1)
    seconds = float(lengths.sum()) / sweeper.speed + sweeper.speed / sweeper.accel
    units = pieces[lengths > 1e-6] / lengths[lengths > 1e-6][:, None]
    turns = np.arccos(np.clip(np.sum(units[1:] * units[:-1], axis=1), -1.0, 1.0))
    if sweeper.turn_radius > 0.0:
        return seconds + float(turns.sum()) * sweeper.turn_radius / sweeper.speed + _ways(path, sweeper)
    return seconds + sum(_corner_time(sweeper, float(turn)) for turn in turns) + _ways(path, sweeper)


def _ways(path: Path, sweeper: Sweeper) -> float:
    total = 0.0
    for end in (path[0], path[-1]):
        level = float(np.linalg.norm(end[:2] - sweeper.start[:2]))
        rise = abs(float(end[2] - sweeper.start[2]))
        total += max(level / sweeper.speed, rise / sweeper.climb) + sweeper.speed / sweeper.accel
    return total
