"""Lanes that follow the ground: a way at a height above it, smoothed so that it can be flown. ENU metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.goals.curves import lengths_of
from agents.planner.model.ground import Floor
from agents.planner.model.problem import Floats, Path
from agents.planner.model.scene import Corner
from zmav.errors import BadInput

WINDOW = 15.0
"""m along the way, before and after, over which its height is evened out; it gets no lower by that"""


class Drape:
    """``height`` metres above the ground within a polygon. Raises :class:`BadInput` where that is not known."""

    def __init__(self, height: float, floor: Floor | None, polygon: Sequence[Corner]) -> None:
        if floor is None:
            text = "no ground is known to the planner: 'zmav swarm planner --terrain'"
            raise BadInput(text, field="above_ground", value=True, expected="a planner that knows the ground")
        if floor.declared is not None and height < floor.declared:
            text = f"{height:g} m above the ground, where {floor.declared:g} m are asked for"
            raise BadInput(text, field="height", value=height, expected=f"{floor.declared:g} m or more")
        self._height, self._floor = height, floor
        xs, ys = zip(*polygon, strict=True)
        low, high = floor.span((min(xs), min(ys), max(xs), max(ys)))
        self.heights = low + height, high + height
        """the lowest and the highest that it may lead"""

    def over(self, path: Path, rests: bool = False) -> Path:
        """The way (K, 3) at its heights; each end no lower than one may rest there, or (``rests``) each place."""
        if not len(path):
            return path
        along = lengths_of(path)
        levels: Floats = np.array([self._up(x, y) + self._height for x, y, _ in path.tolist()])
        ends = [(path[0], along <= WINDOW), (path[-1], along >= along[-1] - WINDOW)]
        for end, near in [(place, along == at) for place, at in zip(path, along, strict=True)] if rests else ends:
            lowest = self._floor.lowest(float(end[0]), float(end[1]))
            levels[near] = np.maximum(levels[near], levels[near] if lowest is None else lowest)
        step = float(along[-1]) / max(len(path) - 1, 1)
        if 0.0 < step < WINDOW / 4.0:
            reach = int(np.ceil(WINDOW / step))
            levels = _windows(levels, reach).max(axis=1)
            for _ in range(2):
                levels = _windows(levels, reach // 2).mean(axis=1)
        return np.column_stack((path[:, :2], levels))

    def _up(self, x: float, y: float) -> float:
        found = self._floor.up(x, y)
        if found is None:
            text = f"the ground {x:.0f} m east and {y:.0f} m north of the origin is not known to the planner"
            raise BadInput(text, field="polygon", value=None, expected="ground that is known: --terrain")
        return found


def _windows(levels: Floats, reach: int) -> Floats:
    """(K, 2 reach + 1): each level with its neighbours, the ends repeated beyond them."""
    return np.lib.stride_tricks.sliding_window_view(np.pad(levels, reach, mode="edge"), 2 * reach + 1)
