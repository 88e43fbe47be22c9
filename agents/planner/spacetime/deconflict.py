"""The two questions that the solver asks of the discrete search."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from agents.planner.geometry import World
from agents.planner.problem import Motion, Path, Problem
from agents.planner.spacetime.negotiate import STEP, Floor
from agents.planner.spacetime.roads import durations

MARGIN = 0.1
"""m kept on top of the radii, where starts and goals leave room for it"""


def find(
    problem: Problem, world: World, paths: Sequence[Path], seconds: float, rng: np.random.Generator
) -> list[Motion] | None:
    """Motions for all, apart from each other and the movers at every instant, along straight lines; None: none found."""
    deadline = time.perf_counter() + seconds
    steps = horizon(problem, paths)
    floor = Floor(problem, world, paths, margin=MARGIN, steps=steps)
    order = np.argsort([-int(chain.ahead[0]) for chain in floor._chains], kind="stable")
    floor.start(order.tolist(), deadline)
    if not floor.settle(deadline, rng):
        return None
    return floor.motions()


def horizon(problem: Problem, paths: Sequence[Path]) -> int:
    longest = 0.0
    for i, path in enumerate(paths):
        taken = durations(np.diff(path, axis=0), problem.vmax[i], problem.climb[i], problem.descend[i], STEP)
        longest = max(longest, float(taken.sum()))
    return int(min(3000, 3 * longest + 100 + 8 * len(problem)))


def repair(
    problem: Problem,
    world: World,
    motions: Sequence[Motion],
    who: Sequence[int],
    seconds: float,
    rng: np.random.Generator,
) -> list[Motion] | None:
    return None
