"""The static world of a scene as arrays, for numba.

ENU metres. A grid of bins over the ground lists the obstacles that stand in each bin; those on the rim reach to
infinity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Ints
from agents.planner.model.scene import Box, Corner, Cylinder, Scene, extent_of, open_ring

FINEST_BIN = 2.0
"""m"""
MOST_BINS = 128
"""on each side"""


class World(NamedTuple):
    """What stands still."""

    bounds: Floats
    """(6,): least x, y, z, greatest x, y, z; the centre stays inside"""
    fence: Floats
    """(F, 2): corners; no rows: no fence"""
    fence_z: Floats
    """(2,): floor, ceiling"""
    solids: Floats
    """(N, 9): the box around each obstacle as the bounds; 0 box, 1 cylinder, 2 prism; a prism's first corner and count
    of corners"""
    corners: Floats
    """(V, 2): of all prisms, one after another"""
    bins: Floats
    """(6,): least x and y of the bins, bins per metre along x and y, how many along x and y"""
    bin_start: Ints
    """(bins + 1,): where each bin's list starts in ``bin_items``; x runs fastest"""
    bin_items: Ints
    """numbers of obstacles"""


def world_of(scene: Scene) -> World:
    """The arrays of a scene's obstacles, bounds and fence."""
    fence = scene.geofence
    bounds = np.array([*scene.bounds.min, *scene.bounds.max], dtype=np.float64)
    rows: list[tuple[float, ...]] = []
    corners: list[Corner] = []
    for each in scene.obstacles:
        low, high = extent_of(each)
        if isinstance(each, Box | Cylinder):
            rows.append((*low, *high, 0.0 if isinstance(each, Box) else 1.0, 0.0, 0.0))
        else:
            ring = open_ring(each.polygon)
            rows.append((*low, *high, 2.0, len(corners), len(ring)))
            corners += ring
    solids = np.array(rows, dtype=np.float64).reshape(-1, 9)
    return World(
        bounds,
        np.array(open_ring(fence.polygon) if fence else [], dtype=np.float64).reshape(-1, 2),
        np.array([fence.floor, fence.ceiling] if fence else [-np.inf, np.inf], dtype=np.float64),
        solids,
        np.array(corners, dtype=np.float64).reshape(-1, 2),
        *_binned(bounds, solids),
    )


def _binned(bounds: Floats, solids: Floats) -> tuple[Floats, Ints, Ints]:
    """The bins, where each one's list starts, and the lists one after another."""
    low, high = bounds[:2], bounds[3:5]
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
    return bins, starts, np.array([k for one in lists for k in one], dtype=np.int64)
