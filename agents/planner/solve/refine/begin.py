"""First guesses: everybody on their way at once, bent aside and spread in height so that few meet head-on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agents.planner.model.geometry import World, segment_clear
from agents.planner.model.problem import ROVER, Floats, Path, Problem
from agents.planner.solve.jit import jit
from agents.planner.solve.refine.knots import knots_of_paths
from agents.planner.solve.refine.swarm import units


@dataclass(frozen=True)
class Guess:
    """How ways are bent before anything else, in radii at most (short ways less)."""

    side: float = 0.5
    """to the right"""
    up: float = 0.0
    """between the highest and the lowest, sorted by course"""
    noise: float = 0.05
    """at random, so that nothing is exactly symmetric"""


def bent(
    problem: Problem, world: World, paths: list[Path], seconds: float, knots: int, guess: Guess, seed: int
) -> Floats:
    """(N, knots + 1, 3): ways flown in ``seconds``, bent where the bent way is clear."""
    place = knots_of_paths(problem, paths, seconds, knots)
    rng = np.random.default_rng(seed)
    across = problem.goal - problem.start
    length = np.linalg.norm(across, axis=1)
    level = np.hypot(across[:, 0], across[:, 1])
    right = np.column_stack([across[:, 1], -across[:, 0], np.zeros(len(problem))]) / np.maximum(level, 1e-6)[:, None]
    unit = units(problem)[0]
    reach = unit * np.minimum(1.0, 0.15 * length / (unit * max(guess.side, guess.up, 1e-6)))
    course = np.arctan2(across[:, 1], across[:, 0])
    rank = np.argsort(np.argsort(course, kind="stable"), kind="stable") / max(1, len(problem) - 1) - 0.5
    # What there is of height may not reach for the whole spread: it is moved up or down to fit.
    middle = 0.5 * (problem.start[:, 2] + problem.goal[:, 2])
    low, high = world.bounds[2] + 0.1, world.bounds[5] - 0.1
    if len(world.fence):
        low, high = max(low, world.fence_z[0] + 0.1), min(high, world.fence_z[1] - 0.1)
    lift = np.clip(middle + guess.up * rank * reach, low, high) - middle
    lift = np.where(problem.kind == ROVER, 0.0, lift)
    bend = guess.side * reach[:, None] * right
    bend[:, 2] += lift
    jitter = guess.noise * rng.standard_normal((len(problem), 3)) * reach[:, None]
    jitter[problem.kind == ROVER, 2] = 0.0
    hump = np.sin(np.pi * np.linspace(0.0, 1.0, knots + 1))[:, None]
    for i in range(len(problem)):
        aside(world, place[i], (bend[i] + jitter[i]) * hump, float(problem.radius[i]))
    return place


@jit
def aside(world: World, way: Floats, offset: Floats, radius: float) -> None:
    """Move each knot of a way by its offset, or by the share of it for which there is room there and next to it."""
    last = way.shape[0] - 1
    room = np.ones(last + 1)
    for k in range(1, last):
        while room[k] > 0.05 and not segment_clear(world, way[k], way[k] + room[k] * offset[k], radius):
            room[k] *= 0.6
        if room[k] <= 0.05:
            room[k] = 0.0
    for turn in range(2):  # what is narrow narrows what comes before and after it, less so further away
        for n in range(1, last + 1):
            k = n if turn == 0 else last - n
            before = k - 1 if turn == 0 else k + 1
            room[k] = min(room[k], room[before] + 0.1)
    for k in range(1, last):
        way[k] += room[k] * offset[k]
