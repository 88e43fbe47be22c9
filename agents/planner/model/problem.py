"""What the solver's stages hand on: a scene as arrays, motions, and things that move by themselves.

ENU metres and seconds, float64, C order. A stage takes a :class:`Problem` and never changes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.scene import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Path = Floats
"""(K, 3): a way through space without times; neighbours joined by straight lines"""
Motion = Floats
"""(T, 4): t, x, y, z; t increasing; neighbours joined by straight lines; the last position is held (planes leave)"""

COPTER, ROVER, PLANE = 0, 1, 2
KINDS = {"copter": COPTER, "rover": ROVER, "plane": PLANE}


@dataclass(frozen=True)
class MovingObstacle:
    """What moves by itself and is only avoided: a vehicle under another's command, a committed trajectory."""

    id: str
    motion: Motion
    radius: float
    leaves: bool = False
    """it is gone after its last sample; else it stays there"""

    def later(self, seconds: float) -> MovingObstacle:
        return replace(self, motion=self.motion + np.array([seconds, 0.0, 0.0, 0.0]))


def places_at(motion: Motion, times: Floats | float) -> Floats:
    """Where a motion is at the times, (K, 3), or at one, (3,): held before its beginning and after its end."""
    return np.stack([np.interp(times, motion[:, 0], motion[:, axis]) for axis in (1, 2, 3)], axis=-1)


@dataclass(frozen=True)
class Problem:
    """N vehicles, each with a goal of its own."""

    ids: tuple[str, ...]
    kind: Ints
    """(N,): COPTER, ROVER or PLANE"""
    start: Floats
    """(N, 3)"""
    goal: Floats
    """(N, 3)"""
    radius: Floats
    """(N,); so are the rest"""
    vmax: Floats
    amax: Floats
    climb: Floats
    """m/s upwards at most (vz_up, or vmax where the scene has none)"""
    descend: Floats
    """m/s downwards at most, positive"""
    vmin: Floats
    heading: Floats
    """planes' first heading, radians counter-clockwise from east; NaN for others"""
    downwash: float
    time_limit: float
    """s; inf: none"""
    movers: tuple[MovingObstacle, ...] = ()

    def __len__(self) -> int:
        return len(self.ids)


def problem_of(scene: Scene, goals: Sequence[int] | None = None, movers: Sequence[MovingObstacle] = ()) -> Problem:
    """The arrays of a scene. ``goals``: which of the scene's ``goals`` each vehicle gets, where they are unlabelled."""
    vehicles = scene.vehicles
    targets = [v.goal for v in vehicles] if goals is None else [(scene.goals or [])[i] for i in goals]

    def column(values: list[float]) -> Floats:
        return np.array(values, dtype=np.float64)

    return Problem(
        ids=tuple(v.id for v in vehicles),
        kind=np.array([KINDS[v.type] for v in vehicles], dtype=np.int64),
        start=np.array([v.start for v in vehicles], dtype=np.float64).reshape(-1, 3),
        goal=np.array(targets, dtype=np.float64).reshape(-1, 3),
        radius=column([v.radius for v in vehicles]),
        vmax=column([v.vmax for v in vehicles]),
        amax=column([v.amax for v in vehicles]),
        climb=column([v.vmax if v.vz_up is None else min(v.vz_up, v.vmax) for v in vehicles]),
        descend=column([v.vmax if v.vz_down is None else min(v.vz_down, v.vmax) for v in vehicles]),
        vmin=column([v.vmin or 0.0 for v in vehicles]),
        heading=np.radians(column([np.nan if v.start_heading_deg is None else v.start_heading_deg for v in vehicles])),
        downwash=scene.downwash,
        time_limit=np.inf if scene.time_limit is None else scene.time_limit,
        movers=tuple(movers),
    )
