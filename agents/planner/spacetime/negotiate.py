"""Ways and times for all together: conflicts at a price that rises until none is left, then shorter ways.

The frame is Li et al., MAPF-LNS2 (AAAI 2022): begin with conflicts, plan small groups anew, keep what is no worse. The
price of a conflict of two grows with every time it is met, as in negotiated routing (McMurchie and Ebeling 1995), so
that a group that is stuck looks elsewhere.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from agents.planner.geometry import World
from agents.planner.problem import ROVER, Floats, Ints, Motion, Path, Problem
from agents.planner.spacetime.lattice import MOVES, Lattice, lattice_of
from agents.planner.spacetime.roads import durations, no_lattice, pitch_for, roads_of
from agents.planner.spacetime.search import BLOCKED, Roads, lay, search
from agents.planner.spacetime.table import Table, empty_table, put, take, troubles

STEP = 0.25
"""s"""
SHARE = 0.8
"""of the greatest speeds, that straight moves are planned at"""
PRICE = 4.0
"""steps that a step of conflict costs at first"""
DEAREST = 400.0
"""steps"""
GROUP = 8
"""vehicles planned anew together, at most"""
AROUND = 12.0
"""m around all paths that the lattice reaches"""
NODES = 60_000.0
"""of a lattice, about"""


class Floor:
    """A problem being negotiated: the table, everybody's roads and way, and who is in conflict with whom."""

    def __init__(
        self,
        problem: Problem,
        world: World,
        paths: Sequence[Path],
        *,
        margin: float,
        steps: int,
        begin: int = 0,
        lattices: dict[tuple[float, ...], Lattice] | None = None,
        pitch: float = 1.0,
    ) -> None:
        self.stats = [0, 0]
        self.problem, self.world, self.begin = problem, world, begin
        self.paths = paths
        count = len(problem)
        every = np.concatenate([*paths, problem.start, problem.goal])
        self.low = np.maximum(every.min(axis=0) - AROUND, world.bounds[:3])
        self.high = np.minimum(every.max(axis=0) + AROUND, world.bounds[3:])
        area = np.array([self.low[0], self.low[1], self.high[0], self.high[1]])
        self.speed, self.climb, self.descend = (SHARE * v for v in (problem.vmax, problem.climb, problem.descend))
        fastest = float(np.max(self.speed))
        self.table: Table = empty_table(problem, STEP, steps, area, fastest, margin)
        bodies = len(self.table.apart)
        self.weight = np.full((bodies, bodies), PRICE)
        self.weight[:, count:] = 10.0 * BLOCKED
        self.last_mover = self._last_of(range(count, bodies))
        self.pitch = pitch
        self.lattices: dict[tuple[float, ...], Lattice] = {} if lattices is None else lattices
        self._moves: list[Ints] = [np.ones(26, dtype=np.int64)] * count
        self._roads: list[Roads | None] = [None] * count
        self._chains: list[Roads] = [self._roads_on(i, no_lattice()) for i in range(count)]
        self.ways: list[Ints] = [np.empty((0, 3), dtype=np.int64)] * count
        self.arrival = np.zeros(count, dtype=np.int64)
        self.filed = np.zeros(count, dtype=bool)
        self.conflicts = np.zeros((bodies, bodies), dtype=np.int64)

    def _last_of(self, bodies: Sequence[int]) -> int:
        """The first step from which none of the bodies moves any more."""
        last = 0
        for body in bodies:
            moved = np.flatnonzero((self.table.places[body, 1:] != self.table.places[body, :-1]).any(axis=1))
            last = max(last, int(moved[-1]) + 1 if len(moved) else 0)
        return min(last, self.table.head.shape[1] - 1)

    def _roads_on(self, i: int, lattice: Lattice) -> Roads:
        p, speeds = self.problem, (float(self.speed[i]), float(self.climb[i]), float(self.descend[i]))
        return roads_of(self.world, lattice, self.paths[i], float(p.radius[i]), *speeds, STEP)

    def lattice(self, i: int) -> Lattice:
        """The lattice of a vehicle's class, made when it is first asked for."""
        p = self.problem
        flat = bool(p.kind[i] == ROVER)
        key = (float(p.radius[i]), float(p.start[i, 2]) if flat else np.nan_to_num(np.inf), self.pitch)
        if key not in self.lattices:
            low, high = self.low.copy(), self.high.copy()
            if flat:
                low[2] = high[2] = p.start[i, 2]
            pitch = self.pitch * pitch_for(key[0], p.downwash, high - low, NODES * self.pitch**3)
            self.lattices[key] = lattice_of(self.world, key[0], pitch, low, high, np.clip(p.start[i], low, high))
        return self.lattices[key]

    def wide(self, i: int) -> tuple[Lattice, Roads]:
        """A vehicle's lattice and its roads on it."""
        lattice, roads = self.lattice(i), self._roads[i]
        if roads is None:
            roads = self._roads[i] = self._roads_on(i, lattice)
            vectors = MOVES * lattice.pitch
            speeds = (float(self.speed[i]), float(self.climb[i]), float(self.descend[i]))
            self._moves[i] = durations(vectors, *speeds, STEP)
        return lattice, roads

    # One vehicle.

    def plan(self, i: int, limit: float, most: int) -> bool:
        """A way for vehicle ``i``, which is not filed; False: none found. It is written to the table, not filed."""
        last = max(self.last_mover, int(self.arrival[self.filed].max(initial=0)), self.begin) + 1
        chain = self._chains[i]
        none = no_lattice()
        rows = search(
            self.table,
            self.weight,
            0.0,
            i,
            none,
            MOVES,
            self._moves[i],
            chain,
            self.begin,
            last,
            most,
            1.0,
            float(self.speed[i]) * STEP,
            1 << 40,
        )
        lattice, roads = none, chain
        direct = int(chain.ahead[0])
        if not len(rows) or rows[-1, 1] - self.begin > direct + max(4, direct // 20):
            lattice, roads = self.wide(i)
            for price in (0.0, limit):
                detour = int(1.2 * direct + 24)
                found = search(
                    self.table,
                    self.weight,
                    price,
                    i,
                    lattice,
                    MOVES,
                    self._moves[i],
                    roads,
                    self.begin,
                    last,
                    most,
                    1.02,
                    float(self.speed[i]) * STEP,
                    detour,
                )
                self.stats[int(price > 0)] += 1
                if len(found) or len(rows):
                    break
            if not len(found) and not len(rows):
                return False
            if len(found) and (not len(rows) or found[-1, 1] < rows[-1, 1]):
                rows = found
            else:
                lattice, roads = none, chain
        if rows[-1, 1] >= self.table.head.shape[1]:
            return False
        lay(rows, lattice, roads, self.table.places[i])
        self.arrival[i], self.ways[i] = rows[-1, 1], rows
        return True

    def file(self, i: int) -> None:
        """File a vehicle's motion and count its conflicts with those filed."""
        counts = np.zeros(len(self.conflicts), dtype=np.int64)
        troubles(self.table, i, counts)
        put(self.table, i)
        self.filed[i] = True
        self.conflicts[i, :] = counts
        self.conflicts[:, i] = counts

    def lift(self, i: int) -> None:
        """Take a vehicle's motion out."""
        take(self.table, i)
        self.filed[i] = False
        self.conflicts[i, :] = 0
        self.conflicts[:, i] = 0

    def set(self, i: int, places: Floats, arrival: int) -> None:
        """Give vehicle ``i``, not filed, a motion that it had before, and file it."""
        self.table.places[i] = places
        self.arrival[i] = arrival
        self.file(i)

    # All of them.

    def start(self, order: Sequence[int], deadline: float) -> None:
        """A first way for everybody, one after another; what cannot be passed is paid for."""
        for i in order:
            if not self.plan(i, BLOCKED, 20_000 if time.perf_counter() < deadline else 1):
                self._go_straight(i)
            self.file(i)

    def _go_straight(self, i: int) -> None:
        """Along the path at once, whatever is in the way."""
        chain = self._chains[i]
        count = len(chain.places)
        rows = np.zeros((count, 3), dtype=np.int64)
        rows[:, 0] = np.arange(count)
        rows[1:, 2] = chain.ahead[:-1] - chain.ahead[1:]
        rows[:, 1] = self.begin + chain.ahead[0] - chain.ahead
        lay(rows, no_lattice(), chain, self.table.places[i])
        self.arrival[i], self.ways[i] = rows[-1, 1], rows

    def clashes(self) -> int:
        """How many pairs are in conflict."""
        return int(np.count_nonzero(np.triu(self.conflicts)))

    def settle(self, deadline: float, rng: np.random.Generator, who: Sequence[int] | None = None) -> bool:
        """Plan groups anew until nobody is in conflict; False: time is over first."""
        free = np.ones(len(self.problem), dtype=bool)
        if who is not None:
            free[:] = False
            free[list(who)] = True
        while True:
            clashing = np.flatnonzero(self.conflicts[: len(free)].any(axis=1) & free)
            if not self.conflicts.any():
                return True
            if not len(clashing) or time.perf_counter() >= deadline:
                return False
            self._dearer()
            self.again(self._group(int(rng.choice(clashing)), free, rng), BLOCKED, rng)

    def _dearer(self) -> None:
        """Raise the price of every conflict that there is."""
        met = self.conflicts > 0
        count = len(self.problem)
        self.weight[:count, :count][met[:count, :count]] = np.minimum(
            self.weight[:count, :count][met[:count, :count]] * 1.1 + 1.0, DEAREST
        )

    def _group(self, one: int, free: Ints, rng: np.random.Generator) -> list[int]:
        """A vehicle in conflict, those it is in conflict with, and theirs, up to a random number."""
        most = int(rng.integers(2, GROUP + 1))
        group, at = [one], 0
        while len(group) < most and at < len(group):
            others = np.flatnonzero(self.conflicts[group[at], : len(free)])
            rng.shuffle(others)
            group += [int(o) for o in others if free[o] and o not in group][: most - len(group)]
            at += 1
        return group

    def again(self, group: list[int], limit: float, rng: np.random.Generator) -> bool:
        """Plan a group anew in a random order; what it had comes back where the new is worse."""
        kept = {i: (self.table.places[i].copy(), int(self.arrival[i]), self.ways[i]) for i in group}
        before = self._badness()
        for i in group:
            self.lift(i)
        order = list(group)
        rng.shuffle(order)
        done = True
        for i in order:
            if not self.plan(i, limit, 20_000):
                done = False
                break
            self.file(i)
        if done and self._badness() <= before:
            return True
        for i in group:
            if self.filed[i]:
                self.lift(i)
        for i, (places, arrival, way) in kept.items():
            self.set(i, places, arrival)
            self.ways[i] = way
        return False

    def _badness(self) -> tuple[float, int, int]:
        """What is to be made small: conflicts, then the last arrival, then all arrivals."""
        pairs = np.triu(self.conflicts > 0)
        return float(pairs.sum()), int(self.arrival.max(initial=0)), int(self.arrival.sum())

    def motions(self) -> list[Motion]:
        """(T, 4) each: the corners of what is in the table."""
        return [motion_of(self.table.places[i], self.begin) for i in range(len(self.problem))]


def motion_of(places: Floats, begin: int) -> Motion:
    """The motion through places at equal steps, without those that lie evenly between others."""
    steps = np.diff(places, axis=0)
    bends = np.flatnonzero((np.abs(np.diff(steps, axis=0)) > 1e-9).any(axis=1)) + 1
    keep = np.unique(np.concatenate(([begin], bends[bends > begin])))
    motion = np.concatenate([keep[:, None] * STEP, places[keep]], axis=1)
    return np.ascontiguousarray(motion)
