"""Who goes to which goal, where that is the planner's choice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.geometry import World, segment_clear
from agents.planner.model.problem import ROVER, Floats, Ints, problem_of
from agents.planner.model.scene import Scene

Bools = NDArray[np.bool_]
SLACK = 1.02  # a last arrival this much later is taken for fewer crossings
DETOUR = 1.25  # a way whose straight line is blocked is taken to be this much longer


def assign(scene: Scene, world: World, never: Bools | None = None) -> list[int] | None:
    """Which of the scene's ``goals`` each vehicle gets; None where the vehicles have goals of their own.

    The last arrival is the earliest possible (bottleneck assignment: a threshold on single times, halved), and among
    these the sum of squared distances is least, which leaves straight ways that hardly cross (Turpin, Michael, Kumar
    2014: CAPT). ``never`` (N, N): pairs of vehicle and goal to be left out, as far as can be.
    """
    if scene.assignment != "unlabelled":
        return None
    goals = np.array(scene.goals or [], dtype=np.float64).reshape(-1, 3)
    if not len(goals):
        return []
    from scipy.optimize import linear_sum_assignment  # takes long to import and is seldom needed

    times, squares = costs(scene, world, goals)
    if never is not None:
        times, squares = np.where(never, 1e9, times), np.where(never, 1e12, squares)
    rows, columns = linear_sum_assignment(squares)
    limit = SLACK * bottleneck(times)
    if times[rows, columns].max() > limit:
        rows, columns = linear_sum_assignment(np.where(times <= limit, squares, 1e12))
    return [int(c) for c in columns[np.argsort(rows)]]


def costs(scene: Scene, world: World, goals: Floats) -> tuple[Floats, Floats]:
    """(N, N) seconds at least, and squared metres; a rover does not leave its height."""
    problem = problem_of(scene, list(range(len(goals))))
    way = goals[None, :, :] - problem.start[:, None, :]
    length = np.linalg.norm(way, axis=2)
    if len(world.solids) or len(world.fence):
        for i, start in enumerate(problem.start):
            for j, goal in enumerate(goals):
                if not segment_clear(world, start, goal, problem.radius[i]):
                    length[i, j] *= DETOUR
    rise = way[:, :, 2]
    cruise = length / problem.vmax[:, None]
    cruise = np.maximum(cruise, np.maximum(rise / problem.climb[:, None], -rise / problem.descend[:, None]))
    ramp = (problem.vmax / problem.amax)[:, None]
    times = np.where(cruise >= ramp, cruise + ramp, 2.0 * np.sqrt(cruise * ramp))
    squares = length * length
    wrong = (problem.kind == ROVER)[:, None] & (np.abs(rise) > scene.goal_tolerance)
    return np.where(wrong, 1e9, times), np.where(wrong, 1e12, squares)


def bottleneck(times: Floats) -> float:
    """The least possible greatest time of a complete assignment."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching

    values = np.unique(times)
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        matched: Ints = maximum_bipartite_matching(csr_matrix(times <= values[middle]), perm_type="column")
        if np.all(matched >= 0):
            high = middle
        else:
            low = middle + 1
    return float(values[low])
