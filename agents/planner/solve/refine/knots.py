"""Between paths and motions of any shape and knots at a common step: time laws, sampling, finer knots, samples."""

from __future__ import annotations

import numpy as np

from agents.planner.model.problem import Floats, Motion, Path, Problem, places_at


def durations(problem: Problem, paths: list[Path]) -> Floats:
    """(N,): seconds that each path takes at least, from rest to rest, corners not counted."""
    result = np.zeros(len(problem))
    for i, path in enumerate(paths):
        cruise = leg_times(problem, i, path).sum()
        ramp = problem.vmax[i] / problem.amax[i]
        result[i] = cruise + ramp if cruise >= ramp else 2.0 * np.sqrt(cruise * ramp)
    return result


def leg_times(problem: Problem, i: int, path: Path) -> Floats:
    """(K - 1,): seconds for each leg of a path at the greatest speed allowed in its direction."""
    legs = np.diff(path, axis=0)
    level = np.linalg.norm(legs, axis=1) / problem.vmax[i]
    least: Floats = np.maximum(level, np.maximum(legs[:, 2] / problem.climb[i], -legs[:, 2] / problem.descend[i]))
    return least


def ramped(share: Floats, ramp: float) -> Floats:
    """Progress (0..1) at shares of the time, with constant acceleration during the first and last ``ramp`` of it."""
    ramp = min(max(ramp, 1e-6), 0.5)
    top = 1.0 / (1.0 - ramp)
    u = np.minimum(share, 1.0 - share)
    half = np.where(u < ramp, top * u * u / (2.0 * ramp), top * (u - ramp / 2.0))
    return np.asarray(np.where(share <= 0.5, half, 1.0 - half), dtype=np.float64)


def knots_of_paths(problem: Problem, paths: list[Path], seconds: float, knots: int) -> Floats:
    """(N, knots + 1, 3): everybody under way all the time, with the same progress law where their limits allow it."""
    share = np.linspace(0.0, 1.0, knots + 1)
    ramps = problem.vmax / problem.amax
    least = durations(problem, paths)
    slowest = int(np.argmax(least)) if len(problem) else 0
    ramp = min(0.5, float(ramps[slowest]) / seconds) if len(problem) else 0.5
    result = np.empty((len(problem), knots + 1, 3))
    for i, path in enumerate(paths):
        times = leg_times(problem, i, path)
        at = np.concatenate([[0.0], np.cumsum(times)])
        own = ramp
        if at[-1] > 0.0 and (at[-1] / (1.0 - ramp) > seconds or at[-1] * ramps[i] / (ramp * (1.0 - ramp)) > seconds**2):
            own = min(0.5, max(ramp, float(ramps[i]) / seconds))
        place = ramped(share, own) * at[-1]
        for axis in range(3):
            result[i, :, axis] = np.interp(place, at, path[:, axis])
        result[i, 0], result[i, -1] = path[0], path[-1]
    return result


def knots_of_motions(motions: list[Motion], seconds: float, knots: int, stretch: float = 1.0) -> Floats:
    """(N, knots + 1, 3): motions sampled, their clocks slowed by ``stretch``."""
    times = np.linspace(0.0, seconds, knots + 1) / stretch
    return np.array([places_at(motion, times) for motion in motions]).reshape(-1, knots + 1, 3)


def resampled(place: Floats, knots: int) -> Floats:
    """(N, knots + 1, 3): other knots on the smooth curve through the given ones (at rest at both ends)."""
    old = place.shape[1] - 1
    if knots == old:
        return place.copy()
    padded = np.concatenate([place[:, 1:2], place, place[:, -2:-1]], axis=1)
    slope = 0.5 * (padded[:, 2:] - padded[:, :-2])
    slope[:, 0] = slope[:, -1] = 0.0
    at = np.linspace(0.0, old, knots + 1)
    k = np.minimum(at.astype(np.int64), old - 1)
    u = (at - k)[None, :, None]
    a, b = place[:, k], place[:, k + 1]
    da, db = slope[:, k], slope[:, k + 1]
    inside = (1 + 2 * u) * (1 - u) ** 2 * a + u * (1 - u) ** 2 * da + u * u * (3 - 2 * u) * b + u * u * (u - 1) * db
    inside[:, 0], inside[:, -1] = place[:, 0], place[:, -1]
    return np.ascontiguousarray(inside)


def samples_of(place: Floats, seconds: float) -> list[Motion]:
    """The knots as motions, rounded as files are; rest at the end is left out."""
    times = np.round(np.linspace(0.0, seconds, place.shape[1]), 6)
    motions: list[Motion] = []
    for knots in np.round(place, 6):
        moves = np.flatnonzero(np.any(knots[1:] != knots[:-1], axis=1))
        end = int(moves[-1]) + 2 if len(moves) else 1
        motions.append(np.column_stack([times[:end], knots[:end]]))
    return motions
