"""The static world of a scene as arrays, for numba.

ENU metres. A grid of bins over the ground lists the obstacles that stand in each bin; those on the rim reach to
infinity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Ints
from agents.planner.model.scene import Box, Corner, Cylinder, Obstacle, Scene

FINEST_BIN = 2.0
"""m"""
MOST_BINS = 128
"""on each side"""


class World(NamedTuple):
    """What stands still. Obstacles are numbered boxes first, then cylinders, then prisms."""

    bounds: Floats
    """(6,): least x, y, z, greatest x, y, z; the centre stays inside"""
    boxes: Floats
    """(B, 6): as the bounds"""
    cylinders: Floats
    """(C, 5): x, y, radius, floor, ceiling"""
    corners: Floats
    """(V, 2): of all prisms, one after another"""
    prisms: Floats
    """(P, 4): index of the first corner, how many, floor, ceiling"""
    fence: Floats
    """(F, 2): corners; no rows: no fence"""
    fence_z: Floats
    """(2,): floor, ceiling"""
    terrain: Floats
    """(4,): height at the origin, rise per metre x and y, clearance; a height of -inf: no terrain"""
    solids: Floats
    """(B + C + P, 9): the box around each obstacle as the bounds; 0 box, 1 cylinder, 2 prism; a prism's first corner
    and count of corners"""
    bins: Floats
    """(6,): least x and y of the bins, bins per metre along x and y, how many along x and y"""
    bin_start: Ints
    """(bins + 1,): where each bin's list starts in ``bin_items``; x runs fastest"""
    bin_items: Ints
    """numbers of obstacles"""


def world_of(scene: Scene, terrain: Sequence[float] | None = None) -> World:
    """The arrays of a scene's obstacles, bounds and fence; ``terrain``: see :class:`World`."""
    fence = scene.geofence
    empty = World(
        bounds=np.array([*scene.bounds.min, *scene.bounds.max], dtype=np.float64),
        boxes=np.empty((0, 6)),
        cylinders=np.empty((0, 5)),
        corners=np.empty((0, 2)),
        prisms=np.empty((0, 4)),
        fence=np.array(open_ring(fence.polygon) if fence else [], dtype=np.float64).reshape(-1, 2),
        fence_z=np.array([fence.floor, fence.ceiling] if fence else [-np.inf, np.inf], dtype=np.float64),
        terrain=np.array(terrain or (-np.inf, 0.0, 0.0, 0.0), dtype=np.float64),
        solids=np.empty((0, 9)),
        bins=np.empty(6),
        bin_start=np.empty(0, dtype=np.int64),
        bin_items=np.empty(0, dtype=np.int64),
    )
    return changed(empty, scene.obstacles)


def changed(world: World, added: Iterable[Obstacle] = (), removed: Iterable[Obstacle] = ()) -> World:
    """The same world with some obstacles more and some less; what was removed must have been in it.

    Raises ValueError otherwise. The result is as if the world had been made again, with what was added at the end.
    """
    rows = [tuple(row) for row in world.boxes.tolist()], [tuple(row) for row in world.cylinders.tolist()]
    rings = [corners_of(world, prism).tolist() for prism in world.prisms]
    prisms = [(ring, float(prism[2]), float(prism[3])) for ring, prism in zip(rings, world.prisms, strict=True)]
    for obstacle in removed:
        kind, row = row_of(obstacle)
        (prisms if kind == 2 else rows[kind]).remove(row)
    for obstacle in added:
        kind, row = row_of(obstacle)
        (prisms if kind == 2 else rows[kind]).append(row)
    first = np.cumsum([0, *(len(ring) for ring, _, _ in prisms)])
    raised = [(first[i], len(ring), floor, ceiling) for i, (ring, floor, ceiling) in enumerate(prisms)]
    return index(
        world._replace(
            boxes=np.array(rows[0], dtype=np.float64).reshape(-1, 6),
            cylinders=np.array(rows[1], dtype=np.float64).reshape(-1, 5),
            corners=np.array([corner for ring, _, _ in prisms for corner in ring], dtype=np.float64).reshape(-1, 2),
            prisms=np.array(raised, dtype=np.float64).reshape(-1, 4),
        )
    )


def row_of(obstacle: Obstacle) -> tuple[int, Any]:
    """0 box, 1 cylinder or 2 prism, and its numbers."""
    if isinstance(obstacle, Box):
        return 0, (*map(float, obstacle.min), *map(float, obstacle.max))
    if isinstance(obstacle, Cylinder):
        x, y = obstacle.center
        return 1, (float(x), float(y), float(obstacle.radius), float(obstacle.floor), float(obstacle.ceiling))
    ring = [[float(x), float(y)] for x, y in open_ring(obstacle.polygon)]
    return 2, (ring, float(obstacle.floor), float(obstacle.ceiling))


def corners_of(world: World, prism: Floats) -> Floats:
    """(K, 2): a prism's corners, of its row of ``prisms``."""
    return world.corners[int(prism[0]) : int(prism[0] + prism[1])]


def open_ring(polygon: Sequence[Corner]) -> list[Corner]:
    """The corners without repeats of the one before, and without the first said again at the end."""
    return [corner for i, corner in enumerate(polygon) if corner != polygon[i - 1]]


def index(world: World) -> World:
    """The same world with ``solids`` and bins made again from its obstacles."""
    solids = solids_of(world)
    low, high = world.bounds[:2], world.bounds[3:5]
    side = math.sqrt(float(np.prod(np.maximum(high - low, 1.0))) / max(1, len(solids)))
    size = max(FINEST_BIN, 0.8 * side)
    count = np.clip(np.ceil((high - low) / size), 1, MOST_BINS).astype(np.int64)
    scale = count / np.maximum(high - low, 1e-9)
    bins = np.array([*low, *scale, *count])
    first = np.clip(np.floor((solids[:, 0:2] - low) * scale), 0, count - 1).astype(np.int64)
    last = np.clip(np.floor((solids[:, 3:5] - low) * scale), 0, count - 1).astype(np.int64)
    lists: list[list[int]] = [[] for _ in range(int(count[0] * count[1]))]
    for k, ((i0, j0), (i1, j1)) in enumerate(zip(first, last, strict=True)):
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                lists[j * int(count[0]) + i].append(k)
    starts = np.concatenate(([0], np.cumsum([len(one) for one in lists]))).astype(np.int64)
    items = np.array([k for one in lists for k in one], dtype=np.int64)
    return world._replace(solids=solids, bins=bins, bin_start=starts, bin_items=items)


def solids_of(world: World) -> Floats:
    """``solids`` of a world."""
    rows = [[*box, 0, 0, 0] for box in world.boxes]
    rows += [[x - r, y - r, floor, x + r, y + r, ceiling, 1, 0, 0] for x, y, r, floor, ceiling in world.cylinders]
    for prism in world.prisms:
        corners, (first, count, floor, ceiling) = corners_of(world, prism), prism
        rows.append([*corners.min(axis=0), floor, *corners.max(axis=0), ceiling, 2, first, count])
    return np.array(rows, dtype=np.float64).reshape(-1, 9)


def extents_of(obstacles: Iterable[Obstacle]) -> Floats:
    """(K, 6): the box around each obstacle, as the bounds."""
    rows = []
    for obstacle in obstacles:
        if isinstance(obstacle, Box):
            rows.append([*obstacle.min, *obstacle.max])
        elif isinstance(obstacle, Cylinder):
            (x, y), r = obstacle.center, obstacle.radius
            rows.append([x - r, y - r, obstacle.floor, x + r, y + r, obstacle.ceiling])
        else:
            x_all, y_all = zip(*obstacle.polygon, strict=True)
            rows.append([min(x_all), min(y_all), obstacle.floor, max(x_all), max(y_all), obstacle.ceiling])
    return np.array(rows, dtype=np.float64).reshape(-1, 6)
