"""Plans made by hand, for tests that need a good one (and then spoil it)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.planner.model.problem import Motion
from agents.planner.model.scene import Scene

Plan = dict[str, Any]


def straight(start: tuple[float, float, float], goal: tuple[float, float, float], v: float, a: float) -> Motion:
    """(T, 4): from rest to rest on a straight line at no more than that speed and acceleration, every 0.1 s or less."""
    length = math.dist(start, goal)
    ramp = min(v / a, math.sqrt(length / a))
    whole = 2.0 * ramp + (length - a * ramp * ramp) / v if length else 0.0
    t = np.linspace(0.0, whole, math.ceil(whole / 0.1) + 1)
    gone = np.where(t < ramp, a * t * t / 2.0, a * ramp * ramp / 2.0 + a * ramp * (t - ramp))
    gone = np.where(whole - t < ramp, length - a * (whole - t) ** 2 / 2.0, gone)
    share = gone / length if length else gone
    places = np.array(start) + share[:, None] * (np.array(goal) - start)
    return np.asarray(np.round(np.column_stack((t, places)), 6), dtype=np.float64)


def steady(start: tuple[float, float, float], goal: tuple[float, float, float], v: float) -> Motion:
    """(T, 4): a plane's: at one speed all the way."""
    whole = math.dist(start, goal) / v
    t = np.linspace(0.0, whole, math.ceil(whole / 0.1) + 1)
    places = np.array(start) + (t / whole)[:, None] * (np.array(goal) - start)
    return np.asarray(np.round(np.column_stack((t, places)), 6), dtype=np.float64)


def straight_plan(scene: Scene) -> Plan:
    """Everybody straight to the goal at once, whatever is in the way; unlabelled: in the scene's order."""
    goals = scene.goals if scene.assignment == "unlabelled" else [v.goal for v in scene.vehicles]
    tracks = {}
    for v, goal in zip(scene.vehicles, goals or [], strict=True):
        assert goal is not None
        track = steady(v.start, goal, v.vmax) if v.type == "plane" else straight(v.start, goal, v.vmax, v.amax)
        tracks[v.id] = track.tolist()
    return {"status": "ok", "planning_time_s": 0.1, "trajectories": tracks}
