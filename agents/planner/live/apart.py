"""Vehicles that rest too near to each other, or to an obstacle, for a plan with its margins to begin there: where they
go first, slowly. Pure geometry: ENU metres, (N, 3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.scene import Obstacle
from agents.planner.model.validate import distance

ROUNDS, STEP = 300, 0.02
"""how often everybody is pushed on, and by how many metres more than is missing"""
FARTHEST = 10.0
"""m that nobody is sent farther than: who finds no room within stays, and the plan fails as it did"""


class Surroundings:
    """What they keep clear of besides each other. ``downwash``: metres of height that count as one."""

    def __init__(self, obstacles: Sequence[Obstacle], movers: Sequence[MovingObstacle], downwash: float) -> None:
        self._obstacles = list(obstacles)
        self._places = np.array([mover.motion[0, 1:] for mover in movers]).reshape(-1, 3)
        self._radii = np.array([mover.radius for mover in movers])
        self.scale = np.array([1.0, 1.0, 1.0 / downwash])

    def wall(self, place: Floats) -> float:
        """m to the nearest obstacle; 0 inside of one."""
        x, y, z = map(float, place)
        return min((distance(each, (x, y, z)) for each in self._obstacles), default=np.inf)

    def mover(self, place: Floats) -> tuple[float, Floats]:
        """m that a mover leaves free around a place, and which way (scaled) leads away from it."""
        if not len(self._radii):
            return np.inf, np.zeros(3)
        away = (place - self._places) * self.scale
        gaps = np.linalg.norm(away, axis=1) - self._radii
        k = int(np.argmin(gaps))
        return float(gaps[k]), away[k]


def free(places: Floats, radii: Floats, around: Surroundings) -> Floats:
    """(N,) m that each has around it where it rests, on top of its radius: half of what it shares with another. Less
    than nothing where it is nearer than it may be.
    """
    at = places * around.scale
    gaps = np.linalg.norm(at[:, None, :] - at[None, :, :], axis=2) - radii[:, None] - radii[None, :]
    np.fill_diagonal(gaps, np.inf)
    spare: Floats = 0.5 * gaps.min(axis=1, initial=np.inf)
    for i, place in enumerate(places):
        spare[i] = min(spare[i], around.wall(place) - radii[i], around.mover(place)[0] - radii[i])
    return spare


def apart(places: Floats, radii: Floats, flat: Sequence[bool], around: Surroundings) -> Floats | None:
    """Places as near as can be to ``places`` with the ``radii`` kept; ``flat``: who keeps its height. None: no room."""
    at = places.astype(np.float64).copy()
    level = np.array(flat, dtype=np.bool_)
    touched = set(range(len(at)))  # whose surroundings are to be looked at: at first everybody's
    for _ in range(ROUNDS):
        push = np.zeros_like(at)
        for i, j, lack in _lacking(at * around.scale, radii):
            way = _way((at[i] - at[j]) * around.scale, i, level[i] or level[j]) * 0.5 * (lack + STEP)
            push[i] += way
            push[j] -= way
        for i in touched:
            gap, away = around.mover(at[i])
            if gap < radii[i]:
                push[i] += _way(away, i, level[i]) * (radii[i] - gap + STEP)
            lack = radii[i] - around.wall(at[i])
            if lack > 0.0:
                push[i] += _way(_uphill(at[i], around), i, level[i]) * (lack + STEP)
        if not push.any():
            return at
        touched = set(np.flatnonzero(push.any(axis=1)).tolist())
        at += push / around.scale
        at[level, 2] = places[level, 2]
        if float(np.abs(at - places).max()) > FARTHEST:
            return None
    return None


def _lacking(at: Floats, radii: Floats) -> list[tuple[int, int, float]]:
    """Pairs that are too near, and by how much."""
    lack = radii[:, None] + radii[None, :] - np.linalg.norm(at[:, None, :] - at[None, :, :], axis=2)
    return [(int(i), int(j), float(lack[i, j])) for i, j in np.argwhere(lack > 0.0) if i < j]


def _way(away: Floats, number: int, level: bool) -> Floats:
    """A unit vector that way; any level one, for each its own, where there is none."""
    way = away * np.array([1.0, 1.0, 0.0 if level else 1.0])
    size = float(np.linalg.norm(way))
    if size > 1e-3:
        return np.asarray(way / size)
    return np.array([np.cos(2.4 * number), np.sin(2.4 * number), 0.0])


def _uphill(place: Floats, around: Surroundings, by: float = 0.05) -> Floats:
    """Which way leads away from the nearest obstacle."""
    return np.array([around.wall(place + by * e) - around.wall(place - by * e) for e in np.eye(3)])
