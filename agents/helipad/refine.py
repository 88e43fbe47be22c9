"""From about where a symbol is to exactly: small patches are aligned with the symbol by Gauss-Newton steps.

The picture is modelled as gain * symbol + offset + a slope of light, moved, turned and scaled a little. The symbol's
derivatives do not change from step to step, so a step for all patches is one matrix product with a matrix made once
(inverse compositional alignment: Baker and Matthews, "Lucas-Kanade 20 Years On", 2004).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agents.helipad.channels import Picture
from agents.helipad.polar import NOISE, sample
from agents.helipad.templates import Symbol

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SIDE = 20
"""samples of a patch each way"""
REACH = 0.72
"""half a patch's side, in heights of the symbol"""
STEP = np.array([0.15, 0.15, 0.2, 0.12])
"""the longest step: x, y (heights), angle (rad), logarithm of the scale"""
DELTA = 0.01


class Aligner:
    """What does not change while patches are aligned with ``symbols``."""

    def __init__(self, symbols: list[Symbol]) -> None:
        axis = (np.arange(SIDE) + 0.5) / SIDE * 2.0 * REACH - REACH
        self.x, self.y = (a.ravel() for a in np.meshgrid(axis, axis))
        pictures, solvers, masks = [], [], []
        for symbol in symbols:
            columns, mask = self._model(symbol)
            solvers.append(np.linalg.pinv(columns) * mask)
            picture = np.where(mask, columns[:, 0], 0.0)
            picture -= picture[mask].mean()
            picture = np.where(mask, picture, 0.0)
            pictures.append(picture / np.linalg.norm(picture))
            masks.append(mask)
        self.pictures: Image = np.array(pictures, dtype=np.float32)
        """(symbols, SIDE * SIDE), mean 0 and norm 1 where ``masks``, 0 elsewhere"""
        self.masks: Image = np.array(masks, dtype=np.float32)
        self.solvers: Image = np.array(solvers, dtype=np.float32)
        """(symbols, 8, SIDE * SIDE): from a patch to gain, offset, slopes, and gain * (x, y, angle, log scale)"""

    def _model(self, symbol: Symbol) -> tuple[Array, NDArray[np.bool_]]:
        x, y = self.x, self.y
        mask = symbol.near(x, y)
        dx = (symbol.at(x + DELTA, y) - symbol.at(x - DELTA, y)) / (2.0 * DELTA)
        dy = (symbol.at(x, y + DELTA) - symbol.at(x, y - DELTA)) / (2.0 * DELTA)
        columns = np.column_stack(
            [symbol.at(x, y), np.ones(len(x)), x, y, -dx, -dy, dx * y - dy * x, -(dx * x + dy * y)]
        )
        return np.where(mask[:, None], columns, 0.0), mask

    def patches(self, picture: Picture, middles: Array, affines: Array) -> Image:
        """(N, SIDE * SIDE): upright, where ``affines`` (N, 2, 2) takes the symbol's axes to pixels."""
        return sample(picture, middles, affines, self.x, self.y)

    def align(
        self, picture: Picture, which: NDArray[np.intp], middles: Array, affines: Array, steps: int
    ) -> tuple[Array, Array]:
        """Better ``middles`` (N, 2) and ``affines`` (N, 2, 2) of symbols number ``which`` (N,)."""
        solver = self.solvers[which]
        for _ in range(steps):
            patches = self.patches(picture, middles, affines)
            found = np.einsum("nkm,nm->nk", solver, patches).astype(float)
            gain = np.maximum(found[:, :1], 2.0)  # nothing there: no step
            move = np.clip(found[:, 4:] / gain, -STEP, STEP)
            middles = middles + np.einsum("nij,nj->ni", affines, move[:, :2])
            affines = affines @ turned(move[:, 2], np.exp(move[:, 3]))
        return middles, affines

    def normalised(self, patches: Image, which: NDArray[np.intp]) -> Image:
        """(N, SIDE * SIDE) of mean 0 and norm about 1 where the symbol's mask is; the same scale elsewhere."""
        mask = self.masks[which]
        count = mask.sum(axis=1, keepdims=True)
        patches = patches - (patches * mask).sum(axis=1, keepdims=True) / count
        power = (patches * patches * mask).sum(axis=1, keepdims=True)
        result: Image = patches / np.sqrt(power + NOISE * NOISE * count)
        return result

    def scores(self, patches: Image, which: NDArray[np.intp]) -> Array:
        """(N,): correlation of normalised ``patches`` with symbols number ``which``."""
        return np.asarray(np.einsum("nm,nm->n", patches, self.pictures[which]), dtype=float)


def turned(angle: Array, scale: Array) -> Array:
    """(N, 2, 2): scaled and turned clockwise (x right, y down)."""
    c, s = np.cos(angle) * scale, np.sin(angle) * scale
    result: Array = np.empty((len(c), 2, 2))
    result[:, 0, 0] = result[:, 1, 1] = c
    result[:, 0, 1], result[:, 1, 0] = -s, s
    return result


def heading(affines: Array) -> Array:
    """(N,): where a symbol's upright points in the picture, clockwise from up, in [0, pi)."""
    angle: Array = np.arctan2(-affines[:, 0, 1], affines[:, 1, 1]) % math.pi
    result: Array = np.where(angle >= math.pi, 0.0, angle)  # the remainder of a tiny negative number
    return result


def window(picture: Picture, middle: Array, reach: float) -> tuple[Picture, Array]:
    """The part of ``picture`` within ``reach`` pixels of ``middle``, and its first pixel (u, v)."""
    low = np.maximum(np.floor(middle - reach).astype(int), 0)
    high = np.minimum(np.ceil(middle + reach).astype(int) + 1, (picture.shape[1], picture.shape[0]))
    return picture[low[1] : high[1], low[0] : high[0]], low.astype(float)
