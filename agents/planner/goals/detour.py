"""The shortest level way between two points of an area with holes: a visibility graph (Lozano-Perez, Wesley 1979)."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from agents.planner.model.problem import Floats

HUG = 0.05
"""m that ways keep inside of the area's edge, so that rounding does not take them out"""


class Detours:
    """Ways within ``area`` (a shapely polygon or several; ENU metres or turned alike)."""

    def __init__(self, area: Any) -> None:
        self._area = area
        shapely.prepare(area)
        inner = area.buffer(-HUG, join_style="mitre")
        corners = shapely.get_coordinates(inner.simplify(HUG / 2.0)) if not inner.is_empty else np.zeros((0, 2))
        self._corners: Floats = np.unique(np.round(corners, 6), axis=0)
        self._between: Floats | None = None

    def clear(self, here: Floats, there: Floats) -> bool:
        """Whether the straight way stays within."""
        return bool(shapely.covers(self._area, shapely.linestrings(np.vstack((here, there)))))

    def way(self, here: Floats, there: Floats) -> Floats | None:
        """(K, 2) from here to there; None where the area has no way."""
        if self.clear(here, there):
            return np.vstack((here, there))
        if self._between is None:
            self._between = self._seen(self._corners, self._corners)
        ends = np.vstack((here, there))
        nodes = np.vstack((self._corners, ends))
        count = len(self._corners)
        seen = np.full((count + 2, count + 2), np.inf)
        seen[:count, :count] = self._between
        seen[count:, :count] = self._seen(ends, self._corners)
        seen[:count, count:] = seen[count:, :count].T
        chain = _shortest(seen, count, count + 1)
        return None if chain is None else nodes[chain]

    def _seen(self, some: Floats, others: Floats) -> Floats:
        """(N, M) metres from each to each, inf where something is between."""
        if not len(some) or not len(others):
            return np.zeros((len(some), len(others)))
        pairs = np.stack(np.broadcast_arrays(some[:, None], others[None]), axis=2)
        lines = shapely.linestrings(pairs)
        lengths = np.linalg.norm(pairs[:, :, 0] - pairs[:, :, 1], axis=2)
        return np.where(shapely.covers(self._area, lines), lengths, np.inf)


def _shortest(lengths: Floats, start: int, end: int) -> list[int] | None:
    """The indices from start to end."""
    from scipy.sparse.csgraph import dijkstra

    far, before = dijkstra(np.where(np.isfinite(lengths), lengths, 0.0), indices=start, return_predecessors=True)
    if not np.isfinite(far[end]):
        return None
    chain = [end]
    while chain[-1] != start:
        chain.append(int(before[chain[-1]]))
    return chain[::-1]
