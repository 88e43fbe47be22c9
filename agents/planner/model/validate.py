"""Can a scene be solved at all, as far as starts and goals tell? Quick, before anything heavy is loaded.

The distances are plain formulas, the same as the format's: a centre keeps its vehicle's radius from every obstacle,
two centres the sum of their radii in the metric with the downwash, and a centimetre is let pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from agents.planner.model.errors import Code, PlanError
from agents.planner.model.scene import Box, Corner, Cylinder, Obstacle, Point, Scene, check, extent_of, name_of

TOLERANCE = 0.01
"""m"""
NAMED = 5
"""at most so many offenders are described; all are in the error's ids"""


def validate(scene: Scene) -> None:
    """Raises :class:`PlanError` for a scene that makes no sense or has no solution; its ids are all offenders.

    What is wrong in several ways gets the first of the format's codes that fits. Goals that are anybody's go by their
    place in the scene: ``goals[3]``. Obstacles between starts and goals (``unreachable``) are the map's to find.
    """
    check(scene)
    vehicles = scene.vehicles
    ids = [v.id for v in vehicles]
    starts, radii = [v.start for v in vehicles], [v.radius for v in vehicles]
    if scene.assignment == "labelled":
        goals, names, room = [v.goal or v.start for v in vehicles], ids, radii
        stays = [v.type != "plane" for v in vehicles]  # a plane is gone when another comes to its goal
    else:
        goals = list(scene.goals or [])
        names = [f"goals[{k}]" for k in range(len(goals))]
        # Any vehicle may get any goal: only what even the smallest cannot do is wrong for certain.
        room = [min(radii)] * len(goals)
        stays = [all(v.type != "plane" for v in vehicles)] * len(goals)
    _clear(scene, "start_in_obstacle", "start", ids, starts, radii)
    _clear(scene, "goal_in_obstacle", "goal", names, goals, room)
    _spread(scene, "starts_overlap", "starts", ids, starts, radii, [True] * len(ids))
    _spread(scene, "goals_overlap", "goals", names, goals, room, stays)
    _within(scene, "start_out_of_bounds", "start", ids, starts)
    _within(scene, "goal_out_of_bounds", "goal", names, goals)
    _level(scene)


def _words(what: str, name: str) -> str:
    return name if name.startswith("goals[") else f"the {what} of {name}"


def _fail(code: Code, offenders: Iterable[str], texts: Sequence[str]) -> None:
    more = len(texts) - NAMED
    raise PlanError(code, offenders, "; ".join(texts[:NAMED]) + (f"; and {more} more" if more > 0 else ""))


def _clear(
    scene: Scene, code: Code, what: str, names: Sequence[str], places: Sequence[Point], radii: Sequence[float]
) -> None:
    offenders, texts = [], []
    extents = np.array([extent_of(obstacle) for obstacle in scene.obstacles]).reshape(-1, 6)
    for name, place, radius in zip(names, places, radii, strict=True):
        gaps = np.maximum(extents[:, :3] - place, place - extents[:, 3:])
        for k in np.flatnonzero((gaps < radius).all(axis=1)).tolist():
            away = distance(scene.obstacles[k], place)
            if away < radius - TOLERANCE:
                what_is = name_of(scene, k)
                where = f"inside {what_is}" if away == 0.0 else f"{away:.2f} m from {what_is}, {radius:g} are needed"
                offenders.append(name)
                texts.append(f"{_words(what, name)} is {where}")
                break
    if offenders:
        _fail(code, offenders, texts)


def _spread(
    scene: Scene,
    code: Code,
    what: str,
    names: Sequence[str],
    places: Sequence[Point],
    radii: Sequence[float],
    counts: Sequence[bool],
) -> None:
    at, reach, stays = np.array(places, dtype=np.float64), np.array(radii), np.array(counts)
    at[:, 2] /= scene.downwash
    pairs = []
    for i in range(len(at) - 1):
        away = np.sqrt(((at[i + 1 :] - at[i]) ** 2).sum(axis=1))
        near = (away < reach[i] + reach[i + 1 :] - TOLERANCE) & stays[i] & stays[i + 1 :]
        pairs += [(i, i + 1 + int(k), float(away[k])) for k in np.flatnonzero(near)]
    if pairs:
        who = sorted({k for i, j, _ in pairs for k in (i, j)})
        texts = [
            f"the {what} of {names[i]} and {names[j]} are {away:.2f} m apart, {radii[i] + radii[j]:g} are needed"
            for i, j, away in pairs
        ]
        if names[0].startswith("goals["):
            texts = [text.removeprefix("the goals of ") for text in texts]
        _fail(code, [names[k] for k in who], texts)


def _within(scene: Scene, code: Code, what: str, names: Sequence[str], places: Sequence[Point]) -> None:
    offenders, texts = [], []
    for name, place in zip(names, places, strict=True):
        beyond = max(
            max(low - v, v - high) for low, v, high in zip(scene.bounds.min, place, scene.bounds.max, strict=True)
        )
        limit = "bounds"
        if scene.geofence is not None and beyond <= TOLERANCE:
            fence = scene.geofence
            level = max(fence.floor - place[2], place[2] - fence.ceiling)
            beyond, limit = max(level, from_polygon(fence.polygon, place[0], place[1])), "geofence"
        if beyond > TOLERANCE:
            offenders.append(name)
            texts.append(f"{_words(what, name)} is {beyond:.2f} m outside of the {limit}")
    if offenders:
        _fail(code, offenders, texts)


def _level(scene: Scene) -> None:
    """Rovers keep their height, so a goal above or below it cannot be reached."""
    high = [
        v
        for v in scene.vehicles
        if v.type == "rover" and v.goal is not None and abs(v.goal[2] - v.start[2]) > scene.goal_tolerance
    ]
    if high and scene.assignment == "labelled":
        texts = [f"{v.id} is a rover, and its goal is not at its height of {v.start[2]:g} m" for v in high]
        _fail("unreachable", [v.id for v in high], texts)


def distance(obstacle: Obstacle, place: Point) -> float:
    """m from an obstacle's surface; 0 inside."""
    x, y, z = place
    if isinstance(obstacle, Box):
        gaps = (max(0.0, lo - v, v - hi) for lo, v, hi in zip(obstacle.min, place, obstacle.max, strict=True))
        return math.hypot(*gaps)
    level = max(0.0, obstacle.floor - z, z - obstacle.ceiling)
    if isinstance(obstacle, Cylinder):
        return math.hypot(max(0.0, math.dist((x, y), obstacle.center) - obstacle.radius), level)
    return math.hypot(from_polygon(obstacle.polygon, x, y), level)


def from_polygon(polygon: Sequence[Corner], x: float, y: float) -> float:
    """m from a polygon; 0 inside."""
    inside, least = False, math.inf
    ax, ay = polygon[-1]
    for bx, by in polygon:
        if (ay > y) != (by > y) and x < ax + (y - ay) * (bx - ax) / (by - ay):
            inside = not inside
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        u = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / square)) if square else 0.0
        least = min(least, math.hypot(x - ax - u * ex, y - ay - u * ey))
        ax, ay = bx, by
    return 0.0 if inside else least
