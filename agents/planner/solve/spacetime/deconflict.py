"""What the solver asks of the discrete search: motions for all."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from agents.planner.model.problem import Ints, Motion, Path, Problem
from agents.planner.model.world import World
from agents.planner.solve.refine.knots import leg_times
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
    world if there were nobody else. The time is used up only as long as there are conflicts.
    """
    begun = time.perf_counter()
    deadline = begun + seconds
    longest = max((leg_times(problem, i, path).sum() for i, path in enumerate(paths)), default=0.0)
    moved = max((float(mover.motion[-1, 0]) for mover in problem.movers), default=0.0)
    length = max(0.0, moved) + 3.0 * longest + 25.0 + 2.0 * len(problem)  # that a table should have room for
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
