"""Make a way shorter where it stands: leave out points, and cut corners as far as the obstacles allow."""

from __future__ import annotations

import numpy as np

from agents.planner.model.geometry import segment_clear
from agents.planner.model.problem import Floats, Path
from agents.planner.model.world import World
from agents.planner.solve.jit import jit
from agents.planner.solve.paths.grid import duration


@jit
def travel_time(path: Path, rates: Floats) -> float:
    """s along a way at full speed; ``rates`` as :func:`agents.planner.solve.paths.grid.duration` has them."""
    total = 0.0
    for n in range(1, len(path)):
        total += duration(path[n, 0] - path[n - 1, 0], path[n, 1] - path[n - 1, 1], path[n, 2] - path[n - 1, 2], rates)
    return total


@jit
def pull(world: World, path: Path, radius: float) -> Path:
    """The way with as few of its points as see each other, looked for from the far end."""
    kept = np.empty_like(path)
    kept[0] = path[0]
    count, at = 1, 0
    while at < len(path) - 1:
        to = len(path) - 1
        while to > at + 1 and not segment_clear(world, path[at], path[to], radius):
            to -= 1
        kept[count] = path[to]
        count, at = count + 1, to
    return kept[:count].copy()


@jit
def cut_corners(world: World, path: Path, radius: float) -> Path:
    """Each corner cut by the longest of a few chords that is clear; a corner becomes two."""
    cut = np.empty((2 * len(path), 3))
    cut[0] = path[0]
    count = 1
    for n in range(1, len(path) - 1):
        before, corner, after = cut[count - 1], path[n], path[n + 1]
        share, found = 1.0, False
        while share > 0.01 and not found:
            cut[count] = corner + share * (before - corner)
            cut[count + 1] = corner + 0.5 * share * (after - corner)
            found = segment_clear(world, cut[count], cut[count + 1], radius)
            share /= 2.0
        if found:
            count += 2
        else:
            cut[count] = corner
            count += 1
    cut[count] = path[-1]
    return cut[: count + 1].copy()


@jit
def shorten(world: World, path: Path, radius: float, rates: Floats, sweeps: int) -> Path:
    """The same way round the obstacles, shorter, in as many rounds as pay, ``sweeps`` at most."""
    best = pull(world, path, radius)
    if len(best) == 2:
        return best
    before = travel_time(best, rates)
    for sweep in range(sweeps):
        tried = best[::-1].copy() if sweep % 2 else best  # from either end in turn
        tried = pull(world, pull(world, cut_corners(world, tried, radius), radius)[::-1].copy(), radius)
        if sweep % 2 == 0:
            tried = tried[::-1].copy()
        after = travel_time(tried, rates)
        if after >= before:
            continue
        gained, best, before = before - after, tried, after
        if len(best) == 2 or gained < 2e-4 * before:
            break
    return best
