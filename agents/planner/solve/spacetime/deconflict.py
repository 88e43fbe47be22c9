"""Ways and times for all together: conflicts at a price that rises until none is left.

The frame is Li et al., MAPF-LNS2 (AAAI 2022): begin with conflicts, plan small groups again, keep what is no worse. The
price of a conflict of two grows with every time it is met, as in negotiated routing (McMurchie and Ebeling 1995), so
that a group that is stuck looks elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.problem import ROVER, Floats, Ints, Motion, Path, Problem
from agents.planner.model.world import World
from agents.planner.solve.refine.knots import leg_times
from agents.planner.solve.spacetime.lattice import MOVES, Lattice, anchor, lattice_of
from agents.planner.solve.spacetime.roads import ROOM, durations, no_lattice, pitch_for, roads_of
from agents.planner.solve.spacetime.search import BLOCKED, FOREVER, Roads, lay, search
from agents.planner.solve.spacetime.table import Table, empty_table, put, take, troubles

SHARE = 0.8
"""of the greatest speeds, that straight moves are planned at"""
PRICE = 4.0
"""steps that a step of conflict costs at first"""
DEAREST = 400.0
"""steps"""
LONGEST = 3000
"""steps"""
LIMIT = BLOCKED / 2.0
HARDLY = 1.05
"""times the steps that one takes alone: so long, one's own path will do"""
DETOUR = 1.2
"""times the steps that one takes alone: longer ways, waits aside, are not looked at"""
MOST = 40_000
"""states of one search"""
GREED = 1.02
GROUP = 8
"""vehicles planned again together, at most"""
AROUND = 12.0
"""times the greatest radius around all paths: so far the lattice reaches"""
LEAST_STEP, MOST_STEP = 0.1, 0.5
"""s"""
NODES = 60_000.0
"""of a lattice, about"""


class Negotiation:
    """The table, everybody's roads and motion, and who is in conflict with whom."""

    def __init__(
        self,
        problem: Problem,
        world: World,
        paths: Sequence[Path],
        *,
        margin: float,
        seconds: float,
        fine: float = 1.0,
    ) -> None:
        """``margin``: share of the radii kept on top of them; ``seconds``: how far the table goes; ``fine``: by which
        the lattice's pitch is multiplied.
        """
        self.problem, self.world, self.paths, self.fine = problem, world, paths, fine
        count = len(problem)
        every = np.concatenate([*paths, problem.start, problem.goal])
        around = AROUND * float(problem.radius.max())
        self.low = np.maximum(every.min(axis=0) - around, world.bounds[:3])
        self.high = np.minimum(every.max(axis=0) + around, world.bounds[3:])
        self.speed, self.climb, self.descend = (SHARE * v for v in (problem.vmax, problem.climb, problem.descend))
        area = np.array([self.low[0], self.low[1], self.high[0], self.high[1]])
        # Two steps for a move from one lane to the next.
        lanes = ROOM * problem.radius / self.speed
        self.step = float(np.clip(np.median(lanes), LEAST_STEP, MOST_STEP))
        """s"""
        steps = min(LONGEST, math.ceil(seconds / self.step))
        self.table: Table = empty_table(problem, self.step, steps, area, float(np.max(self.speed)), margin)
        bodies = len(self.table.apart)
        self.weight = np.full((bodies, bodies), PRICE)
        self.weight[:, count:] = 10.0 * BLOCKED
        moved = np.flatnonzero(np.diff(self.table.places[count:], axis=1).any(axis=(0, 2)))
        self.moved_until = min(int(moved[-1]) + 1 if len(moved) else 0, self.table.head.shape[1] - 1)
        """the first step from which none of the movers moves any more"""
        self.lattices: dict[tuple[float, float], Lattice] = {}
        self._moves: list[Ints] = [np.ones(26, dtype=np.int64)] * count
        self._roads: list[Roads | None] = [None] * count
        self._chains = [self._roads_on(i, no_lattice()) for i in range(count)]
        self.alone = np.array([int(chain.ahead[0]) for chain in self._chains], dtype=np.int64)
        """steps that each would take if there were nobody else"""
        self.arrival = np.zeros(count, dtype=np.int64)
        self.filed = np.zeros(count, dtype=np.bool_)
        self.conflicts = np.zeros((bodies, bodies), dtype=np.int64)
        """steps in which two are too near"""

    def _speeds(self, i: int) -> tuple[float, float, float]:
        return float(self.speed[i]), float(self.climb[i]), float(self.descend[i])

    def _roads_on(self, i: int, lattice: Lattice) -> Roads:
        return roads_of(self.world, lattice, self.paths[i], float(self.problem.radius[i]), *self._speeds(i), self.step)

    def lattice(self, i: int) -> Lattice:
        """The lattice of a vehicle's class, made when it is first asked for."""
        p = self.problem
        flat = bool(p.kind[i] == ROVER)
        key = (float(p.radius[i]), float(p.start[i, 2]) if flat else -np.inf)
        if key not in self.lattices:
            low, high = self.low.copy(), self.high.copy()
            if flat:
                low[2] = high[2] = p.start[i, 2]
            pitch = self.fine * pitch_for(key[0], p.downwash, high - low, NODES)
            alike = np.concatenate([self._chains[j].places for j in np.flatnonzero(p.radius == p.radius[i])])
            through = np.clip(anchor(self.world, key[0], pitch, alike), low, high)
            self.lattices[key] = lattice_of(self.world, key[0], pitch, low, high, through)
        return self.lattices[key]

    def wide(self, i: int) -> tuple[Lattice, Roads]:
        """A vehicle's lattice and its roads on it."""
        lattice, roads = self.lattice(i), self._roads[i]
        if roads is None:
            roads = self._roads[i] = self._roads_on(i, lattice)
            self._moves[i] = durations(MOVES * lattice.pitch, *self._speeds(i), self.step)
        return lattice, roads

    # One vehicle.

    def plan(self, i: int, limit: float = 0.0, delay: int = 0, enough: int = 0) -> bool:
        """A way for vehicle ``i``, which is not filed, written to the table; False: none found.

        It leaves ``delay`` steps late or later, and need not arrive before step ``enough``.
        Along its own path if that takes hardly longer than alone; else over the lattice; else, where ``limit`` allows
        it, at a price.
        """
        lattice, roads = no_lattice(), self._chains[i]
        rows = self._search(i, lattice, roads, 0.0, delay, FOREVER)
        will_do = max(delay + self.alone[i] * HARDLY + 4, enough)
        if not len(rows) or rows[-1, 1] > will_do:
            wide = self.wide(i)
            found = self._search(i, *wide, 0.0, delay, int(rows[-1, 1]) if len(rows) else FOREVER)
            if not len(found) and not len(rows) and limit > 0.0:
                found = self._search(i, *wide, limit, delay, FOREVER)
            if len(found) and (not len(rows) or found[-1, 1] < rows[-1, 1]):
                rows, (lattice, roads) = found, wide
        if not len(rows) or rows[-1, 1] >= self.table.head.shape[1]:
            return False
        self._lay(i, rows, lattice, roads)
        return True

    def _search(self, i: int, lattice: Lattice, roads: Roads, limit: float, delay: int, before: int) -> Ints:
        last = max(self.moved_until, int(self.arrival[self.filed].max(initial=0)), delay) + 1
        pace, detour = float(self.speed[i]) * self.step, int(DETOUR * self.alone[i]) + 24
        weight, moves = self.weight, self._moves[i]
        return search(
            self.table, weight, limit, i, lattice, MOVES, moves, roads, delay, last, MOST, GREED, pace, detour, before
        )

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

    # All of them.

    def start(self, order: Sequence[int], deadline: Deadline) -> None:
        """A first way for everybody, one after another; what cannot be passed is paid for.

        When half the time is over, anyone who can wait on its own path does, however long; when it is over twice, the
        rest go straight, anyone who is in the way.
        """
        whole = deadline.left()
        for i in order:
            left = deadline.left()
            enough = FOREVER if left < whole / 2.0 else int(self.arrival.max())
            over = left < -whole
            if over or not self.plan(i, LIMIT if left > 0.0 else 0.0, enough=enough):
                self._go_straight(i)
            self.file(i)

    def _go_straight(self, i: int) -> None:
        """Along the path at once, whatever is in the way."""
        chain = self._chains[i]
        count = len(chain.places)
        rows = np.zeros((count, 3), dtype=np.int64)
        rows[:, 0] = np.arange(count)
        rows[1:, 2] = chain.ahead[:-1] - chain.ahead[1:]
        rows[:, 1] = chain.ahead[0] - chain.ahead
        self._lay(i, rows, no_lattice(), chain)

    def _lay(self, i: int, rows: Ints, lattice: Lattice, roads: Roads) -> None:
        """Write a way to the table."""
        lay(rows, lattice, roads, self.table.places[i])
        self.arrival[i] = rows[-1, 1]

    def settle(self, deadline: Deadline, rng: np.random.Generator) -> bool:
        """Plan groups again until nobody is in conflict; False: time is over first."""
        while True:
            clashing = np.flatnonzero(self.conflicts[: len(self.problem)].any(axis=1))
            if not self.conflicts.any():
                return True
            if not len(clashing) or deadline.over:
                return False
            self._dearer()
            self.again(self._group(int(rng.choice(clashing)), rng), rng)

    def _dearer(self) -> None:
        """Raise the price of every conflict that there is."""
        count = len(self.problem)
        weight, met = self.weight[:count, :count], self.conflicts[:count, :count] > 0
        weight[met] = np.minimum(weight[met] * 1.1 + 1.0, DEAREST)

    def _group(self, one: int, rng: np.random.Generator) -> list[int]:
        """A vehicle in conflict, those it is in conflict with, and theirs, up to a random number."""
        most = int(rng.integers(1, GROUP + 1))
        group, at = [one], 0
        while len(group) < most and at < len(group):
            others = np.flatnonzero(self.conflicts[group[at], : len(self.problem)])
            rng.shuffle(others)
            group += [int(o) for o in others if o not in group][: most - len(group)]
            at += 1
        return group

    def again(self, group: list[int], rng: np.random.Generator) -> None:
        """Plan a group again, in any order; it gets back what it had if there are more conflicts then."""
        kept = {i: (self.table.places[i].copy(), int(self.arrival[i])) for i in group}
        before = self._badness()
        for i in group:
            self.lift(i)
        rng.shuffle(group)
        # Two that meet half-way in a narrow place pass only if one of them is late.
        late = 0 if rng.random() < 0.5 else int(rng.integers(1, 1 + self.alone.max()))
        for n, i in enumerate(group):
            if not self.plan(i, LIMIT, 0 if n else late):
                break
            self.file(i)
        else:
            if self._badness() <= before:
                return
        for i, (places, arrival) in kept.items():
            if self.filed[i]:
                self.lift(i)
            self.table.places[i], self.arrival[i] = places, arrival
            self.file(i)

    def _badness(self) -> int:
        """How many pairs are in conflict."""
        return int(np.triu(self.conflicts > 0).sum())

    def motions(self) -> list[Motion]:
        """(T, 4) each: the corners of what is in the table."""
        return [motion_of(self.table.places[i], self.step) for i in range(len(self.problem))]


def motion_of(places: Floats, step: float) -> Motion:
    """The motion through places at equal steps, without those that lie evenly between others."""
    steps = np.diff(places, axis=0)
    bends = np.flatnonzero((np.abs(np.diff(steps, axis=0)) > 1e-9).any(axis=1)) + 1
    keep = np.concatenate(([0], bends))
    motion = np.concatenate([keep[:, None] * step, places[keep]], axis=1)
    return np.ascontiguousarray(motion)


FINE = 0.55
QUICK = 1.25
"""times the last arrival if everybody were alone: as good as it needs to be"""
MARGIN = 0.05
"""share of the radii kept on top of the radii, where starts and goals leave room for it"""


def find(
    problem: Problem, world: World, paths: Sequence[Path], deadline: Deadline, rng: np.random.Generator
) -> list[Motion] | None:
    """Motions for all along straight lines, apart from each other and the movers at every instant; None: none found.

    They go at up to 0.8 of the greatest speeds and change velocity at once. ``paths``: everybody's way through the
    world if there were nobody else. The time is used up only as long as there are conflicts.
    """
    seconds = deadline.left()
    longest = max((leg_times(problem, i, path).sum() for i, path in enumerate(paths)), default=0.0)
    moved = max((float(mover.motion[-1, 0]) for mover in problem.movers), default=0.0)
    length = max(0.0, moved) + 3.0 * longest + 25.0 + 2.0 * len(problem)  # that a table should have room for
    best: Negotiation | None = None
    for order, fine in attempts(problem, paths, rng):
        if best is not None and fine < 1.0:
            break  # it takes five times as long, and finds no shorter ways where the first lattice has some
        talk = Negotiation(problem, world, paths, margin=MARGIN, seconds=length, fine=fine)
        talk.start(order.tolist(), deadline.within(deadline.left() / 2.0))
        left = deadline.left()
        patience = max(1.0, left / 4.0) if best is None else seconds - left
        if talk.settle(deadline.within(patience), rng) and (best is None or talk.arrival.max() < best.arrival.max()):
            best = talk
        spent = seconds - deadline.left()
        if best is not None and (best.arrival.max() <= QUICK * best.alone.max() + 4 or spent > seconds / 4.0):
            break
        if spent > seconds:
            break
    return None if best is None else best.motions()


def attempts(problem: Problem, paths: Sequence[Path], rng: np.random.Generator) -> Iterator[tuple[Ints, float]]:
    """Who is planned before whom, and how fine a lattice is: first the longest ways first, then so but one direction of
    travel before the other; then both on a lattice that smaller bays have a node in; then any order.
    """
    times = np.array([leg_times(problem, i, path).sum() for i, path in enumerate(paths)])
    ways = problem.goal - problem.start
    _, _, axes = np.linalg.svd(ways, full_matrices=False)
    longest, one_way = np.argsort(-times, kind="stable"), np.lexsort((-times, ways @ axes[0] < 0.0))
    for fine in (1.0, FINE):
        yield longest, fine
        yield one_way, fine
    while True:
        for fine in (1.0, FINE):
            yield rng.permutation(len(problem)), fine
