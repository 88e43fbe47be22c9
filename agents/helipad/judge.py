"""Which proposals are the symbol: by correlation, by the learned check, or by a margin against other letters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agents.helipad import polar
from agents.helipad.channels import Pyramid
from agents.helipad.check import Check
from agents.helipad.search import FINE_PX, Proposals
from agents.helipad.templates import Symbol, competitors

Array = NDArray[np.float64]

LEAST_CORRELATION = 0.5
"""with the learned check"""
LEAST_ALONE = 0.80
"""correlation without it"""
MARGIN = 0.06
"""of correlation before the best competitor"""
SCALES = (0.85, 1.0, 1.15)


class Judge:
    """``learned``: the symbols are the built-in H's, which the check knows."""

    def __init__(self, symbols: list[Symbol], learned: bool) -> None:
        self._check = Check.built_in() if learned else None
        self._bank = None if learned else polar.Bank(competitors(symbols), SCALES, 2.0 * math.pi)
        self._grid = polar.grid()

    def scores(self, picture: Pyramid, proposals: Proposals, sure: float) -> Array:
        """(N,): 0 for what is not the symbol, else how sure it is, up to 1. ``sure``: the least of the check."""
        if not len(proposals.correlation):
            return proposals.correlation
        correlation = np.clip(proposals.correlation, 0.0, 1.0)
        if self._check is not None:
            probability = self._check.probability(proposals.patches)
            good = (correlation >= LEAST_CORRELATION) & (probability >= sure)
            return np.where(good, correlation * probability, 0.0)
        good = (correlation >= LEAST_ALONE) & (correlation - self._others(picture, proposals) >= MARGIN)
        return np.where(good, correlation, 0.0)

    def _others(self, picture: Pyramid, proposals: Proposals) -> Array:
        """(N,): the best correlation of another letter at the same place."""
        if self._bank is None:
            return np.zeros(len(proposals.correlation))
        tall = float(np.median(np.linalg.norm(proposals.affines[:, :, 1], axis=1)))
        fine, factors = picture.shrunk(FINE_PX / tall)
        middles = (proposals.middles - picture.origin + 0.5) * factors - 0.5
        patches = polar.sample(fine, middles, proposals.affines * factors[:, None], *self._grid)
        return self._bank.match(polar.normalised(patches, self._bank.weight))[0]
