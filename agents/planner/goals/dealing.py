"""One way of dealing a search out: the ground cut into parts that take each vehicle the same time.

At first the parts go by width and speed; the lanes laid over them give the times that they take, by which the parts are
cut again, a few times over.
"""

from __future__ import annotations

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
SHRINK = 0.97
"""times as much at least is dealt in the next round to who would not be back in time: a cut moves whole lanes"""


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

    @property
    def nothing(self) -> Part:
        return Part(self.sweeper, shapely.Polygon(), self.path[:0], 0.0)

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
        cos, sin = math.cos(angle), math.sin(angle)
        self._back = np.array([[cos, sin], [-sin, cos]])
        """points of rows times this are points in the world"""
        self._starts = np.array([s.start[:2] for s in sweepers]) @ self._back.T

    def deal(self, along: bool) -> list[Part] | None:
        """Parts in the sweepers' order; ``along``: cut across x, else across y. None where lanes cannot be joined."""
        axis = 0 if along else 1
        places, below = self._profile(axis)
        order = np.argsort(self._starts[:, axis], kind="stable").tolist()
        endurance = np.array([self._sweepers[i].endurance for i in order])
        paces = 1.0 / np.array([self._sweepers[i].width * self._sweepers[i].speed for i in order])
        shares, most = _shares(paces, np.ones(len(order))), endurance
        best: list[Part] | None = None
        cuts: list[float] = []
        for _ in range(ROUNDS):
            before, cuts = cuts, np.interp(np.append(0.0, np.cumsum(shares)) * below[-1], below, places).tolist()
            if cuts == before:
                break  # the same cuts again: so will all further ones be
            made = {i: self._part(i, axis, cuts[k], cuts[k + 1], 0 if along else None) for k, i in enumerate(order)}
            parts = [part for _, part in sorted(made.items()) if part is not None]
            if len(parts) < len(order):
                break
            kept = [part if part.seconds <= part.sweeper.endurance else part.nothing for part in parts]
            if best is None or self.rank(kept) < self.rank(best):
                best = kept
            taken = np.array([parts[i].seconds for i in order])
            paces = np.where(taken > 0.0, taken / np.maximum(shares, 1e-9), paces)
            most = most * np.clip(endurance / np.maximum(taken, 1e-9), SHRINK, 1.0)
            shares = _shares(paces, most / paces)
        return best

    def rank(self, parts: Sequence[Part]) -> tuple[float, float]:
        """What sees more comes first; of those that see the same, to a hundredth, what is done sooner."""
        seen = sum(part.area.area for part in parts if len(part.path))
        return (-round(seen / self._wanted.area, 2), max(part.seconds for part in parts))

    def _profile(self, axis: int) -> tuple[Floats, Floats]:
        """Cuts, and the area below each."""
        left, bottom, right, top = self._wanted.bounds
        low, high = (left, right) if axis == 0 else (bottom, top)
        places = np.linspace(low, high, SLICES + 1)
        if axis == 0:
            boxes = shapely.box(places[:-1], bottom - 1.0, places[1:], top + 1.0)
        else:
            boxes = shapely.box(left - 1.0, places[:-1], right + 1.0, places[1:])
        slices = shapely.area(shapely.intersection(self._wanted, boxes))
        return places, np.concatenate(([0.0], np.cumsum(slices)))

    def _part(self, i: int, axis: int, low: float, high: float, corner: int | None) -> Part | None:
        """Vehicle i's lanes between two cuts."""
        sweeper = self._sweepers[i]
        left, bottom, right, top = self._wanted.bounds
        box = shapely.box(low, bottom, high, top) if axis == 0 else shapely.box(left, low, right, high)
        area = self._wanted.intersection(box)
        lanes = []
        if high > low:
            lanes = lanes_over(area, sweeper.width * (1.0 - self._overlap), self._lanes)
        if not lanes:
            return Part(sweeper, shapely.Polygon(), np.zeros((0, 3)), 0.0)
        level = tour(lanes, self._starts[i], self._ways, corner)
        if level is None:
            return None
        flat = level @ self._back
        path = np.column_stack((flat, np.full(len(flat), sweeper.height)))
        world = affinity.rotate(area, self._angle, origin=(0.0, 0.0), use_radians=True)
        return Part(sweeper, world, path, seconds_of(path, sweeper))


def _shares(paces: Floats, most: Floats) -> Floats:
    """(N,) shares of the ground so that all are done at the same time, by the seconds that the whole would take each;
    none above ``most``. They come to one where that can be.
    """
    shares = np.zeros(len(paces))
    for _ in range(len(paces)):
        free = shares < most
        if not free.any():
            break
        rates = np.where(free, 1.0 / paces, 0.0)
        shares = np.minimum(shares + (1.0 - shares.sum()) * rates / rates.sum(), most)
    return shares


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
    return seconds + sum(_corner_time(sweeper, float(turn)) for turn in turns) + _ways(path, sweeper)


def _ways(path: Path, sweeper: Sweeper) -> float:
    total = 0.0
    for end in (path[0], path[-1]):
        level = float(np.linalg.norm(end[:2] - sweeper.start[:2]))
        rise = abs(float(end[2] - sweeper.start[2]))
        total += max(level / sweeper.speed, rise / sweeper.climb) + sweeper.speed / sweeper.accel
    return total
