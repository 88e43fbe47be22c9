"""The two questions that the solver asks of the discrete search: motions for all, and new ones for a few."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from agents.planner.model.problem import PLANE, Floats, Ints, Motion, MovingObstacle, Path, Problem
from agents.planner.model.world import World
from agents.planner.solve.spacetime.negotiate import Negotiation

FINE = 0.55
QUICK = 1.25
"""times the last arrival if everybody were alone: as good as it needs to be"""
MARGIN = 0.05
"""share of the radii kept on top of the radii, where starts and goals leave room for it"""


def find(
    problem: Problem, world: World, paths: Sequence[Path], seconds: float, rng: np.random.Generator
) -> list[Motion] | None:
    """Motions for all along straight lines, apart from each other and the movers at every instant; None: none found.

    They go at up to 0.8 of the greatest speeds and change velocity at once. ``paths``: everybody's way through the
    world if there were nobody else. The time is used up only as long as there are conflicts; what is found is then
    made quicker for half as long as that took.
    """
    begun = time.perf_counter()
    deadline, length = begun + seconds, horizon(problem, paths)
    best: Negotiation | None = None
    for order, fine in attempts(problem, paths, rng):
        if best is not None and fine < 1.0:
            break  # it takes five times as long, and finds no shorter ways where the first lattice has some
        talk = Negotiation(problem, world, paths, margin=MARGIN, seconds=length, fine=fine)
        now = time.perf_counter()
        talk.start(order.tolist(), now + (deadline - now) / 2.0)
        now = time.perf_counter()
        patience = max(1.0, (deadline - now) / 4.0) if best is None else now - begun
        if talk.settle(min(deadline, now + patience), rng) and (
            best is None or talk.arrival.max() < best.arrival.max()
        ):
            best = talk
        now = time.perf_counter()
        if best is not None and (best.arrival.max() <= QUICK * best.alone.max() + 4 or now - begun > seconds / 4.0):
            break
        if now > deadline:
            break
    if best is None:
        return None
    best.hasten(min(deadline, now + (now - begun) / 2.0), rng)
    return best.motions()


def attempts(problem: Problem, paths: Sequence[Path], rng: np.random.Generator) -> Iterator[tuple[Ints, float]]:
    """Who is planned before whom, and how fine a lattice is: first the longest ways first, then so but one direction of
    travel before the other; then both on a lattice that smaller bays have a node in; then any order.
    """
    times = np.array([travel(problem, i, path) for i, path in enumerate(paths)])
    ways = problem.goal - problem.start
    _, _, axes = np.linalg.svd(ways, full_matrices=False)
    longest, one_way = np.argsort(-times, kind="stable"), np.lexsort((-times, ways @ axes[0] < 0.0))
    for fine in (1.0, FINE):
        yield longest, fine
        yield one_way, fine
    while True:
        for fine in (1.0, FINE):
            yield rng.permutation(len(problem)), fine


def travel(problem: Problem, i: int, path: Path) -> float:
    """Seconds along a path at full speed."""
    legs = np.diff(path, axis=0)
    rises = np.maximum(legs[:, 2] / problem.climb[i], -legs[:, 2] / problem.descend[i])
    return float(np.maximum(np.linalg.norm(legs, axis=1) / problem.vmax[i], rises).sum())


def horizon(problem: Problem, paths: Sequence[Path], begin: float = 0.0) -> float:
    """Seconds from ``begin`` that a table should have room for."""
    longest = max((travel(problem, i, path) for i, path in enumerate(paths)), default=0.0)
    moved = max((float(mover.motion[-1, 0]) for mover in problem.movers), default=0.0)
    return max(0.0, moved - begin) + 3.0 * longest + 25.0 + 2.0 * len(problem)


def repair(
    problem: Problem,
    world: World,
    motions: Sequence[Motion],
    who: Sequence[int],
    paths: Sequence[Path],
    seconds: float,
    rng: np.random.Generator,
    begin: float = 0.0,
) -> list[Motion] | None:
    """The motions with new ones for the vehicles ``who``, clear of all others' as these are; None: none found.

    ``who`` are at rest at their starts at ``begin`` s, or a step later; ``paths``: theirs, in the same order. Their
    new motions begin then.
    """
    others = [i for i in range(len(problem)) if i not in set(who)]
    fixed = tuple(
        MovingObstacle(problem.ids[i], motions[i], float(problem.radius[i]), leaves=bool(problem.kind[i] == PLANE))
        for i in others
    )
    few = part(replace(problem, movers=problem.movers + fixed), np.array(who, dtype=np.int64))
    deadline = time.perf_counter() + seconds
    length = horizon(few, paths, begin)
    talk = Negotiation(few, world, paths, margin=MARGIN, seconds=length, begin=begin)
    talk.start(np.argsort(-talk.alone, kind="stable").tolist(), deadline)
    if not talk.settle(deadline, rng):
        return None
    new = dict(zip(who, talk.motions(), strict=True))
    return [new.get(i, motion) for i, motion in enumerate(motions)]


def part(problem: Problem, who: Ints) -> Problem:
    """The same with some of the vehicles only."""
    columns = ("kind", "start", "goal", "radius", "vmax", "amax", "climb", "descend", "vmin", "heading")
    chosen: dict[str, Floats] = {name: np.ascontiguousarray(getattr(problem, name)[who]) for name in columns}
    return replace(problem, ids=tuple(problem.ids[i] for i in who), **chosen)  # type: ignore[arg-type]
