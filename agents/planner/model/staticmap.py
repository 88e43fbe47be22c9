"""What stands still, made ready for many searches, and kept warm from plan to plan for as long as it stays the same.

A way is looked for as a straight line first, then on a coarse lattice, which nearly always has one: soon, then all of
it. Then come samples, ever finer lattices, and samples again. From an end that is walled in, finer lattices come first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agents.planner.model import geometry
from agents.planner.model.deadline import NEVER, Deadline
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import COPTER, ROVER, Floats, Path, Problem
from agents.planner.model.world import World
from agents.planner.solve.paths import grid, lattice, sampled, shorten

COARSE_POINTS = (80_000, 20_000)
"""of the first lattice, in space and on the ground; each next one has lines twice as near"""
MOST_POINTS = 8_000_000
"""of the finest lattice: 140 MB"""
MOST_LATTICES = 16
"""kept at a time"""
FIRST_LOOK, MOST_LOOKS = 20_000, 200_000
"""expansions of the first search, 20 to 70 ms, and of any other one: half a second"""
FEW_LOOKS = 2_000
"""of one that tells whether an end is walled in"""
FINEST = 0.5
"""radii between the lines of the finest lattice: where all of that was looked at, there is no way"""
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


class StaticMap:
    """Ways through a world that stands still."""

    patience = 2.0
    """s of the processor for a vehicle whose way is not found at once"""
    thorough = 4.0
    """s more for all vehicles of a problem for which no way was found in that time"""

    def __init__(self, world: World) -> None:
        self.world = world
        self._layers: dict[tuple[int, float, float | None], Layer] = {}

    def path(
        self,
        start: Floats,
        goal: Floats,
        radius: float,
        kind: int = COPTER,
        rates: Sequence[float] = UNHURRIED,
        room: float = 0.0,
        until: Deadline | None = None,
    ) -> Path | None:
        """A way from ``start`` to ``goal``, (3,) each, that is among the quickest; None: none was found.

        Every point of it keeps ``radius`` from every obstacle and is inside bounds and fence; ``room`` m more where a
        way with that is found at once and hardly takes longer. ``rates``: m/s in any direction, upwards, downwards. A
        rover stays at its start's height. ``until``: when to give up, more or less,
        if no way is found at once; without it after :attr:`patience`.
        """
        world, speeds = self.world, np.array(rates, dtype=np.float64)
        direct = np.array([start, goal], dtype=np.float64)
        height = float(start[2]) if kind == ROVER else None
        if height is not None:
            direct[1, 2] = height
        if not len(world.solids):
            room = 0.0  # it is room between obstacles
        if geometry.segment_clear(world, direct[0], direct[1], radius + room):
            return direct
        roomy = None if room == 0.0 else self._path(direct, radius + room, speeds, height, None)
        straight = geometry.segment_clear(world, direct[0], direct[1], radius)
        if roomy is not None:
            takes = shorten.travel_time(roomy, speeds)
            if takes <= AROUND * shorten.travel_time(direct, speeds):
                return roomy
            near = direct if straight else self._path(direct, radius, speeds, height, None)
            return roomy if near is None or takes <= AROUND * shorten.travel_time(near, speeds) else near
        return (
            direct if straight else self._path(direct, radius, speeds, height, until or Deadline.after(self.patience))
        )

    def paths_for(self, problem: Problem, room: float = 0.0, until: Deadline = NEVER) -> list[Path]:
        """A way for each vehicle, in order; all is given up at ``until``.

        Raises :class:`PlanError`, ``unreachable``, with all vehicles for which none was found in some seconds;
        ``timeout``, with all that have none, where there was no time for that.
        """
        paths = self._ways(problem, room, [None] * len(problem), self.patience, until)
        if any(path is None for path in paths):  # the time was short for many, or for a busy machine
            paths = self._ways(problem, room, paths, self.thorough, until)
        names = [problem.ids[i] for i, path in enumerate(paths) if path is None]
        if names and until.over:
            raise PlanError("timeout", names, f"no way to the goal of {', '.join(names)} was found in time")
        if names:
            raise PlanError("unreachable", names, f"there is no way to the goal of {', '.join(names)}")
        return [path for path in paths if path is not None]

    def _ways(
        self, problem: Problem, room: float, known: list[Path | None], patience: float, until: Deadline
    ) -> list[Path | None]:
        """Those of ``known`` that are None looked for, for ``patience`` s and a tenth more for each."""
        rates, paths = np.stack((problem.vmax, problem.climb, problem.descend), axis=1), list(known)
        for i in [i for i, path in enumerate(known) if path is None]:
            together = until.within(patience)
            ends = problem.start[i], problem.goal[i], float(problem.radius[i]), int(problem.kind[i])
            paths[i] = self.path(*ends, rates[i].tolist(), room, until.within(max(0.1, patience)))
            if paths[i] is None:  # what makes one search long makes the next one long
                patience = together.left()
        return paths

    def _path(
        self, ends: Floats, radius: float, rates: Floats, height: float | None, until: Deadline | None
    ) -> Path | None:
        """A search that ends soon, or else all of that lattice; then samples, which come through slots that no line of
        a lattice lies in, searches on finer lattices, and samples again; what is found is shortened. Each time samples
        have a quarter of the time that is left. ``until`` None: the first search only.
        """
        world, start, goal = self.world, ends[0], ends[1]
        first = self._layer(0, radius, height)
        path, done = first.search(world, start, goal, rates, 1, FIRST_LOOK)
        if path is None and until is not None and not until.over:
            path, none, closed = self._out(ends, radius, rates, height, until)
            if path is None and not done and not any(closed):  # the rest of it takes less than samples do
                path, _ = first.search(world, start, goal, rates, 2, MOST_LOOKS)
            if path is None and height is None and not until.over:
                path = sampled.find(world, start, goal, radius, until.within(until.left() / 4.0))
            if path is None and not none and not closed[-1]:
                path, none = self._finer(ends, radius, rates, height, until)
            if path is None and not none and height is None and not until.over:
                path = sampled.find(world, start, goal, radius, until.within(until.left() / 4.0))
        return None if path is None else shorten.shorten(world, path, radius, rates, SWEEPS)

    def _out(
        self, ends: Floats, radius: float, rates: Floats, height: float | None, until: Deadline
    ) -> tuple[Path | None, bool, list[bool]]:
        """A way from an end that is walled in, where there is little to look at, however fine the lattice; whether
        the finest has none; and which ends, the goal first, the first lattice leads nowhere from.
        """
        layer, closed = self._layer(0, radius, height), list[bool]()
        looks = FIRST_LOOK if layer.spacing < FINEST * radius else FEW_LOOKS
        for step, speeds in ((-1, rates[[0, 2, 1]]), (1, rates)):
            way, none = ends[::step], False
            path, done = layer.search(self.world, way[0], way[1], speeds, 2, looks)
            closed.append(path is None and done)
            if closed[-1]:
                path, none = self._finer(way, radius, speeds, height, until)
            if path is not None or none:
                return None if path is None else path[::step].copy(), none, closed
        return None, False, closed

    def _finer(
        self, ends: Floats, radius: float, rates: Floats, height: float | None, until: Deadline
    ) -> tuple[Path | None, bool]:
        """A way by ever finer lattices than the first; and whether the finest has none: one more is tried after it."""
        level, none, more = 1, False, 8 if height is None else 4
        while not until.over:
            layer = self._layer(level, radius, height)
            path, done = layer.search(self.world, ends[0], ends[1], rates, 2, MOST_LOOKS)
            last = path is not None or none or layer.lines.size * more > MOST_POINTS
            none = path is None and (none or (done and layer.spacing < FINEST * radius))
            if last:
                return path, none
            level += 1
        return None, none

    def _layer(self, level: int, radius: float, height: float | None) -> Layer:
        key = (level, radius, height)
        layer = self._layers.pop(key, None)
        if layer is None:
            spacing = spacing_of(self.world, height) / 2.0**level
            layer = Layer(lattice.lattice_of(self.world, spacing, radius, height), spacing, radius)
            while len(self._layers) >= MOST_LATTICES:
                del self._layers[next(iter(self._layers))]
        self._layers[key] = layer  # the one used last is the last to go
        return layer


def spacing_of(world: World, height: float | None) -> float:
    """m between the lines of the first lattice."""
    low, high = lattice.extent(world)
    span = np.maximum(high - low, 1e-3)
    if height is not None:
        return float(np.sqrt(span[0] * span[1] / COARSE_POINTS[1]))
    return float(np.cbrt(np.prod(span) / COARSE_POINTS[0]))
