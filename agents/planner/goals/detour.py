"""The shortest level way between two points of an area with holes: a visibility graph (Lozano-Perez, Wesley 1979)."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

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
        self._far: tuple[Floats, NDArray[np.int32]] | None = None
        """(N, N) metres from each corner to each, and which one comes before the last on the way"""

    def clear(self, here: Floats, there: Floats) -> bool:
        """Whether the straight way stays within."""
        return bool(shapely.covers(self._area, shapely.linestrings(np.vstack((here, there)))))

    def way(self, here: Floats, there: Floats) -> Floats | None:
        """(K, 2) from here to there; None where the area has no way."""
        if self.clear(here, there):
            return np.vstack((here, there))
        if not len(self._corners):
            return None
        if self._far is None:
            from scipy.sparse.csgraph import dijkstra  # takes long to import and is seldom needed

            between = self._seen(self._corners, self._corners)
            self._far = dijkstra(np.where(np.isfinite(between), between, 0.0), return_predecessors=True)
        far, before = self._far
        out, back = self._seen(np.vstack((here, there)), self._corners)
        whole = out[:, None] + far + back
        if not np.isfinite(whole).any():
            return None
        first, last = divmod(int(np.argmin(whole)), len(back))
        chain = [last]
        while chain[-1] != first:
            chain.append(int(before[first, chain[-1]]))
        return np.vstack((here, self._corners[chain[::-1]], there))

    def _seen(self, some: Floats, others: Floats) -> Floats:
        """(N, M) metres from each to each, inf where something is between."""
        if not len(some) or not len(others):
            return np.zeros((len(some), len(others)))
        pairs = np.stack(np.broadcast_arrays(some[:, None], others[None]), axis=2)
        lines = shapely.linestrings(pairs)
        lengths = np.linalg.norm(pairs[:, :, 0] - pairs[:, :, 1], axis=2)
        return np.where(shapely.covers(self._area, lines), lengths, np.inf)
