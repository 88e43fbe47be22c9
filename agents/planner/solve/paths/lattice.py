"""The points that the grid search looks at: where lines along x, y and z cross.

The lines are evenly spaced, and where two obstacles leave a gap narrower than that there is one more in its middle: a
window in a wall, of whatever width, has a point of the lattice in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats, Ints
from agents.planner.model.world import World

MOST_GAPS = 150
"""lines in gaps along each axis; the narrowest gaps come first"""


class Lattice(NamedTuple):
    """Point (i, j, k) is number (k * len(y) + j) * len(x) + i."""

    x: Floats
    y: Floats
    z: Floats

    @property
    def size(self) -> int:
        return len(self.x) * len(self.y) * len(self.z)


def lattice_of(world: World, spacing: float, radius: float, height: float | None = None) -> Lattice:
    """Lines at most ``spacing`` apart within bounds and fence, and in the gaps that a ``radius`` passes.

    ``height``: the only z, for what stays on the ground.
    """
    low, high = extent(world)
    found = gaps(world, low, high, spacing, radius)
    axes = []
    for axis in range(3):
        count = max(1, math.ceil((high[axis] - low[axis]) / spacing))
        # Half a step inside, so that no line runs along the rim.
        even = low[axis] + (np.arange(count) + 0.5) * (high[axis] - low[axis]) / count
        axes.append(np.unique(np.concatenate((even, found[axis]))))
    if height is not None:
        axes[2] = np.array([height])
    return Lattice(*axes)


def extent(world: World) -> tuple[Floats, Floats]:
    """Least and greatest x, y, z of where a centre may be: bounds and fence together."""
    low, high = world.bounds[:3].copy(), world.bounds[3:].copy()
    if len(world.fence):
        low = np.maximum(low, [*world.fence.min(axis=0), world.fence_z[0]])
        high = np.minimum(high, [*world.fence.max(axis=0), world.fence_z[1]])
    return low, np.maximum(low, high)


def gaps(world: World, low: Floats, high: Floats, spacing: float, radius: float) -> list[Floats]:
    """Middles of what is free between two obstacles, or an obstacle and the rim, along x, y and z: narrower than
    ``spacing``. Two obstacles make a gap where they face each other, with less than ``spacing`` to spare aside.
    """
    count = len(world.solids)
    lower = np.concatenate((world.solids[:, :3], [high + radius] * 3))
    upper = np.concatenate((world.solids[:, 3:6], [low - radius] * 3))
    # Three planes on each side stand for the rim: each closes one axis and faces everything.
    rim_low, rim_high = np.full((3, 3), -np.inf), np.full((3, 3), np.inf)
    lower_all = np.concatenate((world.solids[:, :3], rim_low))
    upper_all = np.concatenate((world.solids[:, 3:6], rim_high))
    found: list[Floats] = []
    for axis in range(3):
        start, end = upper[:, axis] + radius, lower[:, axis] - radius
        width = end[None, :] - start[:, None]
        near = (width > 0.0) & (width < spacing)
        for other in range(3):
            if other != axis:
                reach = 2.0 * radius + spacing
                near &= lower_all[None, :, other] < upper_all[:, None, other] + reach
                near &= upper_all[None, :, other] > lower_all[:, None, other] - reach
        near[count:, count:] = False
        one, two = np.nonzero(near)
        narrowest = np.argsort(width[one, two], kind="stable")
        middles = np.round((start[one] + end[two])[narrowest] / 2.0, 6)
        _, new = np.unique(middles, return_index=True)
        found.append(middles[np.sort(new)[:MOST_GAPS]])
    return found


def corners_of(lattice: Lattice, point: Floats, reach: int) -> Ints:
    """Numbers of the points of the lattice around a place: the nearest ``reach`` lines on either side of it."""
    picked = []
    for line, at in zip(lattice, point, strict=True):
        after = int(np.searchsorted(line, at))
        picked.append(np.arange(max(0, after - reach), min(len(line), after + reach)))
    i, j, k = np.meshgrid(*picked, indexing="ij")
    numbers: Ints = ((k * len(lattice.y) + j) * len(lattice.x) + i).ravel().astype(np.int64)
    return numbers
