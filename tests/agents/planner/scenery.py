"""What generated scenes are put together from: places, boxes, vehicles, and the bound on the makespan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.planner.model.scene import Bounds, Box, Cylinder, Fence, Obstacle, Point, Scene, Vehicle

Places = NDArray[np.float64]
Scale = Literal["field", "lab"]
SIZE = {"field": 1.0, "lab": 0.15}
SPEED = {"field": 5.0, "lab": 1.0}
PUSH = {"field": 2.5, "lab": 2.0}
DOWNWASH = 1.5


def xy(x: float, y: float) -> tuple[float, float]:
    return (round(float(x), 3), round(float(y), 3))


def point(place: Places) -> Point:
    x, y, z = (round(float(value), 3) + 0.0 for value in place)
    return (x, y, z)


def room(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> Bounds:
    return Bounds(min=point(np.array([x0, y0, z0])), max=point(np.array([x1, y1, z1])))


def box(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> Box:
    """From any two opposite corners."""
    a, b = np.array([x0, y0, z0]), np.array([x1, y1, z1])
    return Box(min=point(np.minimum(a, b)), max=point(np.maximum(a, b)))


def grid(n: int, step: float, height: float = 0.0) -> Places:
    """(n, 3): a level square about the vertical axis."""
    side = math.ceil(math.sqrt(n))
    k = np.arange(n)
    return (
        np.column_stack((k % side - (side - 1) / 2.0, k // side - (side - 1) / 2.0, np.full(n, height / step))) * step
    )


def gap(obstacle: Obstacle, place: Places) -> float:
    """At most the distance of a place from an obstacle over the ground, or below or above it."""
    x, y, z = place
    if isinstance(obstacle, Box):
        return float(max(max(lo - v, v - hi) for lo, v, hi in zip(obstacle.min, place, obstacle.max, strict=True)))
    level = max(obstacle.floor - z, z - obstacle.ceiling)
    if isinstance(obstacle, Cylinder):
        return float(max(level, math.dist((x, y), obstacle.center) - obstacle.radius))
    polygon = np.array(obstacle.polygon)
    middle = polygon.mean(axis=0)
    reach = float(np.linalg.norm(polygon - middle, axis=1).max())
    return float(max(level, math.dist((x, y), middle) - reach))


def scatter(
    n: int,
    rng: np.random.Generator,
    bounds: Bounds,
    obstacles: Sequence[Obstacle],
    radius: float,
    *,
    low: float,
    high: float,
) -> Places:
    """(n, 3): places apart from each other and from every obstacle, between two heights."""
    lo, hi = np.array(bounds.min) + 1.5 * radius, np.array(bounds.max) - 1.5 * radius
    found = np.empty((0, 3))
    for _ in range(200_000):
        if len(found) == n:
            return found
        place = np.array([*rng.uniform(lo[:2], hi[:2]), rng.uniform(low, high)])
        difference = (found - place) / [1.0, 1.0, DOWNWASH]
        if len(found) and np.linalg.norm(difference, axis=1).min() < 2.5 * radius:
            continue
        if all(gap(obstacle, place) >= 1.5 * radius for obstacle in obstacles):
            found = np.vstack((found, place))
    raise ValueError(f"no room for {n} vehicles")


def scene_of(
    name: str,
    seed: int,
    start: Places,
    goal: Places,
    bounds: Bounds,
    scale: Scale,
    obstacles: Sequence[Obstacle] = (),
    *,
    labelled: bool = True,
    geofence: Fence | None = None,
) -> Scene:
    """A scene of copters, with its time limit."""
    vehicles = [
        Vehicle(
            id=f"v{k:03d}",
            type="copter",
            start=point(start[k]),
            goal=point(goal[k]) if labelled else None,
            radius=SIZE[scale],
            vmax=SPEED[scale],
            amax=PUSH[scale],
        )
        for k in range(len(start))
    ]
    found = Scene(
        name=f"{name}{'_lab' if scale == 'lab' else ''}_n{len(start):03d}_s{seed}",
        vehicles=vehicles,
        bounds=bounds,
        assignment="labelled" if labelled else "unlabelled",
        goals=None if labelled else [point(g) for g in goal],
        obstacles=list(obstacles),
        geofence=geofence,
        downwash=DOWNWASH,
        goal_tolerance=0.5 * SIZE[scale],
    )
    return limited(found)


def limited(scene: Scene) -> Scene:
    """With the bound on the makespan, and with ten times as much and a minute as the limit.

    The bound is a straight flight with a trapezoid of speed; unlabelled: of the best bottleneck assignment.
    """
    starts = np.array([v.start for v in scene.vehicles])
    goals = np.array(scene.goals if scene.goals is not None else [v.goal for v in scene.vehicles])
    way = np.linalg.norm(starts[:, None] - goals[None], axis=2)
    ways = np.diag(way) if scene.goals is None else way[np.arange(len(way)), _bottleneck(way)]
    bound = max(
        shortest_time(max(0.0, float(length) - scene.goal_tolerance), v)
        for length, v in zip(ways, scene.vehicles, strict=True)
    )
    total = round(float(np.maximum(0.0, ways - scene.goal_tolerance).sum()), 3)
    lower = {"makespan": round(bound, 3), "sum_length": total}
    return msgspec.structs.replace(scene, lower_bound=lower, time_limit=round(60.0 + 10.0 * bound, 3))


def shortest_time(length: float, vehicle: Vehicle) -> float:
    """s from rest to rest over ``length`` metres; planes fly all the time."""
    v, a = vehicle.vmax, vehicle.amax
    if vehicle.type == "plane":
        return length / v
    return length / v + v / a if length >= v * v / a else 2.0 * math.sqrt(length / a)


def _bottleneck(way: Places) -> NDArray[np.int64]:
    """Which goal each one gets so that the longest way is the shortest."""
    from scipy.optimize import linear_sum_assignment

    lengths = np.unique(way)
    low, high = 0, len(lengths) - 1
    best = linear_sum_assignment(way)[1]
    while low <= high:
        middle = (low + high) // 2
        rows, columns = linear_sum_assignment(way > lengths[middle])
        if (way > lengths[middle])[rows, columns].any():
            low = middle + 1
        else:
            best, high = columns, middle - 1
    return np.asarray(best, dtype=np.int64)
