"""Vehicles that rest too near to each other, or to an obstacle, for a plan with its margins to begin there: where they
go first, slowly. Pure geometry: ENU metres, (N, 3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.goals.pads import rings
from agents.planner.live.frames import vector
from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.scene import Obstacle
from agents.planner.model.validate import distance

STEP = 0.4
"""m between the places that are tried around each: 24 rings of them"""


class Surroundings:
    """What they keep clear of besides each other. ``downwash``: metres of height that count as one."""

    def __init__(self, obstacles: Sequence[Obstacle], movers: Sequence[MovingObstacle], downwash: float) -> None:
        self._obstacles = list(obstacles)
        self._places = np.array([mover.motion[0, 1:] for mover in movers]).reshape(-1, 3)
        self._radii = np.array([mover.radius for mover in movers])
        self.scale = np.array([1.0, 1.0, 1.0 / downwash])

    def wall(self, place: Floats) -> float:
        """m to the nearest obstacle; 0 inside of one."""
        return min((distance(each, vector(place)) for each in self._obstacles), default=np.inf)

    def mover(self, place: Floats) -> float:
        """m to the nearest mover."""
        away = np.linalg.norm((place - self._places) * self.scale, axis=1) - self._radii
        return float(away.min(initial=np.inf))


def free(places: Floats, radii: Floats, around: Surroundings) -> Floats:
    """(N,) m that each has around it where it rests, on top of its radius: half of what it shares with another. Less
    than nothing where it is nearer than it may be.
    """
    at = places * around.scale
    gaps = np.linalg.norm(at[:, None, :] - at[None, :, :], axis=2) - radii[:, None] - radii[None, :]
    np.fill_diagonal(gaps, np.inf)
    spare: Floats = 0.5 * gaps.min(axis=1, initial=np.inf)
    for i, place in enumerate(places):
        spare[i] = min(spare[i], around.wall(place) - radii[i], around.mover(place) - radii[i])
    return spare


def apart(places: Floats, radii: Floats, around: Surroundings) -> Floats | None:
    """Places near ``places``, on the same level, with the ``radii`` kept; who has room stays. None: no room."""
    found, taken = places.astype(np.float64).copy(), list[int]()
    for i in np.argsort(-free(places, radii, around), kind="stable").tolist():
        for spot in map(np.array, rings(vector(places[i]), STEP)):
            gaps = np.linalg.norm((found[taken] - spot) * around.scale, axis=1) - radii[taken] - radii[i]
            if gaps.min(initial=np.inf) >= 0.0 and min(around.wall(spot), around.mover(spot)) >= radii[i]:
                found[i] = spot
                taken.append(i)
                break
        else:
            return None
    return found
