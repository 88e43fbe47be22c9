"""Lanes over an area, side by side along x, and the order in which they are flown.

Boustrophedon cells (Choset 2000): neighbouring lanes that see no hole begin or end between them make a cell, which is
flown to and fro; cells follow one another by the shortest way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from agents.planner.goals.detour import Detours
from agents.planner.model.problem import Floats

CRUMB = 0.5
"""m, and m²: less is not flown for"""
CORNERS = 4
"""of a cell, at which it can be begun"""


@dataclass(frozen=True)
class Lane:
    """One straight pass."""

    row: int
    y: float
    low: float
    high: float

    def points(self, backwards: bool) -> Floats:
        xs = (self.high, self.low) if backwards else (self.low, self.high)
        return np.array([[xs[0], self.y], [xs[1], self.y]])


def lanes_over(part: Any, width: float, free: Any) -> list[Lane]:
    """Lanes ``width`` metres apart at most that see all of ``part``, as far as they stay within ``free``.

    A lane reaches as far as the part does anywhere in its strip, so that slanted borders are seen, too.
    """
    if part.is_empty or part.area < CRUMB:
        return []
    left, bottom, right, top = part.bounds
    rows = max(1, math.ceil((top - bottom) / width - 1e-9))
    high = (top - bottom) / rows
    lows = bottom + high * np.arange(rows)
    strips = shapely.intersection(part, shapely.box(left - 1.0, lows, right + 1.0, lows + high))
    found = []
    for row, strip in enumerate(strips):
        y = float(lows[row] + high / 2.0)
        spans = [piece.bounds for piece in shapely.get_parts(strip) if piece.area > CRUMB * CRUMB]
        whole = shapely.union_all([shapely.linestrings([[b[0], y], [b[2], y]]) for b in spans])
        for piece in shapely.get_parts(shapely.line_merge(shapely.intersection(whole, free))):
            ends = shapely.get_coordinates(piece)
            if len(ends) > 1 and float(np.ptp(ends[:, 0])) >= CRUMB:
                found.append(Lane(row, y, float(ends[:, 0].min()), float(ends[:, 0].max())))
    return found


def cells_of(lanes: list[Lane]) -> list[list[Lane]]:
    """Lanes in groups that are flown to and fro: rows next to each other, each with one neighbour above and below."""

    def beside(lane: Lane, row: int) -> list[Lane]:
        return [other for other in lanes if other.row == row and other.low < lane.high and other.high > lane.low]

    cells, taken = [], set[int]()
    for lane in sorted(lanes, key=lambda each: (each.row, each.low)):
        if id(lane) in taken:
            continue
        cell = [lane]
        taken.add(id(lane))
        while True:
            above = beside(cell[-1], cell[-1].row + 1)
            if len(above) != 1 or len(beside(above[0], cell[-1].row)) != 1 or id(above[0]) in taken:
                break
            cell.append(above[0])
            taken.add(id(above[0]))
        cells.append(cell)
    return cells


def to_and_fro(cell: list[Lane], corner: int) -> Floats:
    """(2 K, 2) the cell's way from one of its four corners: bit 0: from the right, bit 1: from the last row."""
    rows = cell[::-1] if corner & 2 else cell
    return np.vstack([lane.points(backwards=bool((k + corner) & 1)) for k, lane in enumerate(rows)])


def tour(lanes: list[Lane], start: Floats, ways: Detours, corner: int | None) -> Floats | None:
    """(K, 2) over all lanes, the nearest cell first; ``corner``: where the first is begun, None: at the nearest.

    None where a cell cannot be reached from another.
    """
    left = cells_of(lanes)
    path, here, first = np.zeros((0, 2)), start, True
    while left:
        options = []
        for cell in left:
            corners = range(CORNERS) if corner is None or not first else [corner]
            legs = [to_and_fro(cell, c) for c in corners]
            options += [(float(np.linalg.norm(leg[0] - here)), k, cell, leg) for k, leg in enumerate(legs)]
        _, _, cell, leg = min(options, key=lambda option: option[:2])
        for point in leg:
            way = ways.way(path[-1], point) if len(path) else None
            if len(path) and way is None:
                return None
            path = np.vstack((path, point[None] if way is None else way[1:]))
        left = [other for other in left if other is not cell]
        here, first = path[-1], False
    return path
