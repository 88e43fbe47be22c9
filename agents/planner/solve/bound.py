"""What no plan can beat: straight ways, flown from rest to rest as fast as each vehicle can."""

from __future__ import annotations

import math

import numpy as np

from agents.planner.model.scene import Scene, Vehicle


def least_time(length: float, v: Vehicle) -> float:
    """s over ``length`` metres with a trapezoid of speed; planes fly as fast as they can all the way."""
    if v.type == "plane":
        return length / v.vmax
    if length * v.amax >= v.vmax * v.vmax:
        return length / v.vmax + v.vmax / v.amax
    return 2.0 * math.sqrt(length / v.amax)


def least_makespan(scene: Scene) -> float:
    """s: the scene's own ``lower_bound`` where it has one, else a straight-line bound on the makespan.

    Ways end where the goal's tolerance begins. Unlabelled: every goal is somebody's and every vehicle has one, so no
    plan is shorter than the nearest of each, over all.
    """
    given = (scene.lower_bound or {}).get("makespan")
    if isinstance(given, int | float) and math.isfinite(given) and given > 0.0:
        return float(given)
    if scene.assignment == "labelled":
        ways = [math.dist(v.start, v.goal or v.start) for v in scene.vehicles]
        pairs = zip(ways, scene.vehicles, strict=True)
        return max(least_time(max(0.0, way - scene.goal_tolerance), v) for way, v in pairs)
    starts = np.array([v.start for v in scene.vehicles], dtype=np.float64)
    goals = np.array(scene.goals, dtype=np.float64)
    away = np.linalg.norm(starts[:, None] - goals[None], axis=2)
    away = np.maximum(0.0, away - scene.goal_tolerance)
    times = np.array([[least_time(float(d), v) for d in row] for row, v in zip(away, scene.vehicles, strict=True)])
    return float(max(times.min(axis=0).max(), times.min(axis=1).max()))
