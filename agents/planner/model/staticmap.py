"""What stands still, made ready for many searches: kept warm from plan to plan, and changed in place.

A way is looked for as a straight line first, then on ever finer lattices, the coarsest of which nearly always has
one. Where a search does not soon come through, it is asked whether there can be a way at all.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from agents.planner.model import geometry
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import COPTER, ROVER, Floats, Path, Problem
from agents.planner.model.scene import Obstacle
from agents.planner.model.world import World, changed, extents_of
from agents.planner.solve.paths import enclosed, grid, lattice, sampled, shorten

COARSE_POINTS = (80_000, 20_000)
"""of the first lattice, in space and on the ground; each next one has lines twice as near"""
MOST_POINTS = 8_000_000
"""of the finest lattice: 140 MB"""
MOST_LATTICES = 16
"""kept at a time"""
FIRST_LOOK = 20_000
"""expansions after which it is asked whether there is a way at all: 20 to 70 ms"""
MOST_LOOKS = 200_000
"""expansions of one search: half a second"""
PATIENCE = 2.0
"""s for a vehicle whose way is not found at once"""
THOROUGH = 10.0
"""s more for all vehicles of a problem for which there neither is a way nor a proof that there is none"""
MOST_PATHS = 4_096
"""kept at a time"""
WEIGHT = 1.1
"""of the heuristic: five times faster than 1 in a city, for half a percent of length before shortening"""
SWEEPS = 8
"""of shortening"""
UNHURRIED = (1.0, 1.0, 1.0)
AROUND = 1.15
"""times the quickest way: a way with more room may take so long"""


@dataclass
class Layer:
    """A lattice, what is known of its points, and room for searches in it."""

    lines: lattice.Lattice
    spacing: float
    radius: float
    height: float | None
    state: NDArray[np.uint8] = field(init=False)
    turn: int = 0

    def __post_init__(self) -> None:
        size = self.lines.size
        self.state = np.zeros(size, dtype=np.uint8)
        self.cost = np.empty(size)
        self.parent = np.empty(size, dtype=np.int32)
        self.mark = np.zeros(size, dtype=np.int32)

    def search(
        self, world: World, start: Floats, goal: Floats, rates: Floats, reach: int, most: int
    ) -> tuple[Path | None, bool]:
        """A way, and whether all was looked at."""
        self.turn += 1
        first, last = (lattice.corners_of(self.lines, end, reach) for end in (start, goal))
        room = grid.Room(self.state, self.cost, self.parent, self.mark, self.turn)
        way, expanded = grid.search(world, self.lines, room, start, goal, first, last, self.radius, rates, WEIGHT, most)
        return (way if len(way) else None), expanded < most

    def forget(self, low: Floats, high: Floats) -> None:
        """What was known of the points between two corners."""
        spans = [
            slice(np.searchsorted(line, a), np.searchsorted(line, b, side="right"))
            for line, a, b in zip(self.lines, low, high, strict=True)
        ]
        x, y, z = self.lines
        self.state.reshape(len(z), len(y), len(x))[spans[2], spans[1], spans[0]] = grid.UNKNOWN


@dataclass(frozen=True)
class Query:
    """What is asked of a map: one vehicle's way."""

    start: tuple[float, ...]
    goal: tuple[float, ...]
    radius: float
    rates: tuple[float, ...]
    height: float | None


class StaticMap:
    """Ways through a world that stands still."""

    def __init__(self, world: World) -> None:
        self.world = world
        self._layers: dict[tuple[int, float, float | None], Layer] = {}
        self._paths: dict[Query, Path] = {}
        self._pockets: dict[tuple[float, float | None], list[enclosed.Pocket]] = {}

    def path(
        self,
        start: Floats,
        goal: Floats,
        radius: float,
        kind: int = COPTER,
        rates: Sequence[float] = UNHURRIED,
        room: float = 0.0,
        patience: float = PATIENCE,
    ) -> Path | None:
        """A way from ``start`` to ``goal``, (3,) each, that is among the quickest; None: none was found.

        Every point of it keeps ``radius`` from every obstacle and is inside bounds, fence and terrain; ``room`` m more
        where a way with that is found at once and hardly takes longer. ``rates``: m/s in any direction, upwards,
        downwards. A rover stays at its start's height, and terrain is nothing to it. ``patience``: s, more or less, if
        no way is found at once.
        """
        world, query = self._query(start, goal, radius, kind, rates)
        begin, end = np.array(query.start), np.array(query.goal)
        if not len(world.solids):
            room = 0.0  # it is room between obstacles
        if geometry.segment_clear(world, begin, end, radius + room):
            return np.array([begin, end])
        roomy = None if room == 0.0 else self._path(world, replace(query, radius=query.radius + room), 0.0)
        straight = geometry.segment_clear(world, begin, end, radius)
        if roomy is not None:
            speeds, direct = np.array(query.rates), np.array([begin, end])
            takes = shorten.travel_time(roomy, speeds)
            if takes <= AROUND * shorten.travel_time(direct, speeds):
                return roomy
            near = direct if straight else self._path(world, query, 0.0)
            return roomy if near is None or takes <= AROUND * shorten.travel_time(near, speeds) else near
        return np.array([begin, end]) if straight else self._path(world, query, patience)

    def separated(self, start: Floats, goal: Floats, radius: float, kind: int = COPTER, seconds: float = 1.0) -> bool:
        """Whether it is proven, now or before, that there is no way."""
        world, query = self._query(start, goal, radius, kind, UNHURRIED)
        return self._decide(world, query, seconds)[1]

    def paths_for(self, problem: Problem, room: float = 0.0, until: float = math.inf) -> list[Path]:
        """A way for each vehicle, in order; all is given up at ``until``, of :func:`time.monotonic`.

        Raises :class:`PlanError`, ``unreachable``, with all vehicles for which there is none: that is proven, or none
        was found in some seconds; ``timeout``, with all that have none, where there was no time for either.
        """
        paths = self._ways(problem, room, [None] * len(problem), min(PATIENCE, until - time.monotonic()))
        missing = [i for i, path in enumerate(paths) if path is None]
        undecided = [i for i in missing if not self.separated(*_ends(problem, i), seconds=0.0)]
        if undecided:  # the time was short for many, or for a busy machine
            paths = self._ways(problem, room, paths, min(THOROUGH, until - time.monotonic()))
            missing = [i for i in missing if paths[i] is None]
            undecided = [i for i in undecided if paths[i] is None]
        names = [problem.ids[i] for i in missing]
        if undecided and time.monotonic() > until:
            raise PlanError("timeout", names, f"no way to the goal of {', '.join(names)} was found in time")
        if missing:
            raise PlanError("unreachable", names, f"there is no way to the goal of {', '.join(names)}")
        return [path for path in paths if path is not None]

    def _ways(self, problem: Problem, room: float, known: list[Path | None], patience: float) -> list[Path | None]:
        """Those of ``known`` that are None looked for, for ``patience`` s and a tenth more for each."""
        rates, paths = np.stack((problem.vmax, problem.climb, problem.descend), axis=1), list(known)
        for i in [i for i, path in enumerate(known) if path is None]:
            begun = time.monotonic()
            start, goal, radius, kind = _ends(problem, i)
            paths[i] = self.path(start, goal, radius, kind, rates[i].tolist(), room, max(0.1, patience))
            if paths[i] is None:  # what makes one search long makes the next one long
                patience -= time.monotonic() - begun
        return paths

    def alternatives(
        self,
        start: Floats,
        goal: Floats,
        radius: float,
        count: int,
        kind: int = COPTER,
        rates: Sequence[float] = UNHURRIED,
    ) -> list[Path]:
        """Up to ``count`` ways that pass the obstacles on other sides, or far apart; the quickest is first.

        Each is found with a pillar standing, a few radii thick, half-way along each of those before it.
        """
        found: list[Path] = []
        pillars: list[Obstacle] = []
        while len(found) < count:
            there = StaticMap(changed(self.world, pillars)) if pillars else self
            path = there.path(start, goal, radius, kind, rates)
            if path is None:
                break
            found.append(path)
            pillar = lattice.pillar_on(self.world, path, 3.0 * radius)
            if pillar is None:
                break
            pillars.append(pillar)
        return found

    def update(self, added: Iterable[Obstacle] = (), removed: Iterable[Obstacle] = ()) -> None:
        """Change the world in place. Only what is near the change is looked at again; ways that are still clear stay,
        unless something is gone that they may have gone around.

        Raises ValueError where something removed was not there; nothing is changed then.
        """
        added, removed = list(added), list(removed)
        self.world = changed(self.world, added, removed)
        touched, gone = extents_of([*added, *removed]), extents_of(removed)
        for key, layer in list(self._layers.items()):
            lines = lattice.lattice_of(self._world_for(layer.height), layer.spacing, layer.radius, layer.height)
            if not all(np.array_equal(a, b) for a, b in zip(lines, layer.lines, strict=True)):
                del self._layers[key]
                continue
            for extent in touched:
                layer.forget(extent[:3] - layer.radius, extent[3:] + layer.radius)
        if removed:
            self._pockets.clear()
        for query, path in list(self._paths.items()):
            world = self._world_for(query.height)
            clear = all(geometry.segment_clear(world, path[i], path[i + 1], query.radius) for i in range(len(path) - 1))
            if not clear or any(_may_help(extent, path, query) for extent in gone):
                del self._paths[query]

    def _query(
        self, start: Floats, goal: Floats, radius: float, kind: int, rates: Sequence[float]
    ) -> tuple[World, Query]:
        begin, end = (tuple(float(v) for v in point) for point in (start, goal))
        height = begin[2] if kind == ROVER else None
        if height is not None:
            end = (*end[:2], height)
        query = Query(begin, end, float(radius), tuple(float(v) for v in rates), height)
        return self._world_for(height), query

    def _world_for(self, height: float | None) -> World:
        """On the ground there is no terrain to keep above."""
        return self.world if height is None else self.world._replace(terrain=np.array([-np.inf, 0.0, 0.0, 0.0]))

    def _path(self, world: World, query: Query, patience: float) -> Path | None:
        if query in self._paths:
            return self._paths[query].copy()
        start, goal, rates = np.array(query.start), np.array(query.goal), np.array(query.rates)
        path = self._search(world, query, start, goal, rates, patience)
        if path is None:
            return None
        path = shorten.shorten(world, path, query.radius, rates, SWEEPS)
        if len(self._paths) >= MOST_PATHS:
            del self._paths[next(iter(self._paths))]
        self._paths[query] = path
        return path.copy()

    def _search(
        self, world: World, query: Query, start: Floats, goal: Floats, rates: Floats, patience: float
    ) -> Path | None:
        """A way before it is shortened. A search that ends soon, or else the question whether there is a way; where
        there may be, samples and longer searches, on finer lattices.
        """
        if self._in_pocket(world, query, start, goal):
            return None
        level, height, end = 0, query.height, time.monotonic() + patience
        path, done = self._layer(0, query.radius, height).search(world, start, goal, rates, 1, FIRST_LOOK)
        if path is not None or patience <= 0.0:
            return path
        crooked, walled = self._decide(world, query, patience / 2.0)
        if walled:
            return None
        if crooked is None and done and height is None:
            # The lattice is too coarse, and samples are quicker than a finer one.
            path = sampled.find(world, start, goal, query.radius, patience / 4.0)
        while path is None and time.monotonic() < end:
            layer = self._layer(level, query.radius, height)
            if not done or level > 0:
                path, _ = layer.search(world, start, goal, rates, 2, MOST_LOOKS if crooked is None else FIRST_LOOK)
            level, more = level + 1, 8 if height is None else 4
            if (crooked is not None and level > 1) or layer.lines.size * more > MOST_POINTS:
                break
        if path is None or crooked is None:
            return crooked if path is None else path
        short = [shorten.shorten(world, way, query.radius, rates, SWEEPS) for way in (path, crooked)]
        return min(short, key=lambda way: shorten.travel_time(way, rates))

    def _in_pocket(self, world: World, query: Query, start: Floats, goal: Floats) -> bool:
        pockets = self._pockets.get((query.radius, query.height), [])
        return any(p.holds(world, query.radius, start) != p.holds(world, query.radius, goal) for p in pockets)

    def _decide(self, world: World, query: Query, seconds: float) -> tuple[Path | None, bool]:
        """A way, if a crooked one, and whether it is proven that there is none."""
        start, goal = np.array(query.start), np.array(query.goal)
        if self._in_pocket(world, query, start, goal):
            return None, True
        found = enclosed.decide(world, query.radius, start, goal, seconds, query.height)
        if isinstance(found, enclosed.Pocket):
            self._pockets.setdefault((query.radius, query.height), []).append(found)
            return None, True
        return found, False

    def _layer(self, level: int, radius: float, height: float | None) -> Layer:
        key = (level, radius, height)
        layer = self._layers.pop(key, None)
        if layer is None:
            world = self._world_for(height)
            spacing = spacing_of(world, height) / 2.0**level
            layer = Layer(lattice.lattice_of(world, spacing, radius, height), spacing, radius, height)
            while len(self._layers) >= MOST_LATTICES:
                del self._layers[next(iter(self._layers))]
        self._layers[key] = layer  # the one used last is the last to go
        return layer


def _ends(problem: Problem, i: int) -> tuple[Floats, Floats, float, int]:
    """Start, goal, radius and kind of one vehicle."""
    return problem.start[i], problem.goal[i], float(problem.radius[i]), int(problem.kind[i])


def spacing_of(world: World, height: float | None) -> float:
    """m between the lines of the first lattice."""
    low, high = lattice.extent(world)
    span = np.maximum(high - low, 1e-3)
    if height is not None:
        return float(np.sqrt(span[0] * span[1] / COARSE_POINTS[1]))
    return float(np.cbrt(np.prod(span) / COARSE_POINTS[0]))


def _may_help(extent: Floats, path: Path, query: Query) -> bool:
    """Whether a way through where something was may be shorter than the way there is."""
    if len(path) == 2:
        return False
    start, goal = np.array(query.start), np.array(query.goal)
    reach = float(np.linalg.norm(extent[3:] - extent[:3])) / 2.0 + query.radius
    middle = (extent[:3] + extent[3:]) / 2.0
    least = np.linalg.norm(middle - start) + np.linalg.norm(goal - middle) - 2.0 * reach
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    slowest = max(1.0, query.rates[0] / min(query.rates[1:]))
    return bool(least < length * slowest)
