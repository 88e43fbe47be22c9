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
    pieces, of = shapely.get_parts(strips, return_index=True)
    large = shapely.area(pieces) > CRUMB * CRUMB
    spans, of = shapely.bounds(pieces[large]), of[large]
    if not len(of):
        return []
    middles = lows + high / 2.0
    passes = shapely.linestrings(np.stack((spans[:, [0, 2]], np.repeat(middles[of, None], 2, axis=1)), axis=2))
    numbers, group = np.unique(of, return_inverse=True)
    whole = shapely.intersection(shapely.multilinestrings(passes, indices=group), free)
    lines, of = shapely.get_parts(shapely.line_merge(whole), return_index=True)
    ends = shapely.bounds(lines)[:, [0, 2]].tolist()
    return [
        Lane(row, y, low, far)
        for row, y, (low, far) in zip(numbers[of].tolist(), middles[numbers[of]].tolist(), ends, strict=True)
        if far - low >= CRUMB
    ]


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
    path: list[Floats] = []
    here = start
    while left:
        corners = range(CORNERS) if corner is None or path else [corner]
        firsts = [(to_and_fro(cell[-1:] if c & 2 else cell[:1], c)[0], c, cell) for cell in left for c in corners]
        _, first, cell = min(firsts, key=lambda each: (float(np.linalg.norm(each[0] - here)), each[1]))
        for begin, end in to_and_fro(cell, first).reshape(-1, 2, 2):
            way = ways.way(path[-1], begin) if path else begin[None]
            if way is None:
                return None
            path += [*way[1 if path else 0 :], end]  # nothing stands in a lane
        left = [other for other in left if other is not cell]
        here = path[-1]
    return np.array(path).reshape(-1, 2)
