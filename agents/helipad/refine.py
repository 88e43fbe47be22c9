"""From about where a symbol is to exactly: small patches are aligned with the symbol by Gauss-Newton steps.

The picture is modelled as gain * symbol + offset + a slope of light, moved, turned and scaled a little. The symbol's
derivatives do not change from step to step, so the normal equations of all patches are one matrix product with a matrix
made once (inverse compositional alignment: Baker and Matthews, "Lucas-Kanade 20 Years On", 2004). In the last step
samples are weighed as Cauchy's distribution has it, so that what hides a part of the symbol does not pull the rest.
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

SIDE = 24
"""samples of a patch each way"""
REACH = 0.864
"""half a patch's side, in heights of the symbol: what is about a pad tells it from a wall's joints"""
STEP = np.array([0.15, 0.15, 0.2, 0.12])
"""the longest step: x, y (heights), angle (rad), logarithm of the scale"""
DELTA = 0.01
DOUBTED = 1.5
"""times the typical distance from the model at which a sample counts half"""
LEAST_GAIN = 6.0
"""steps of 8 bits between ground and paint"""
RIDGE = 1e-3


class Aligner:
    """What does not change while patches are aligned with ``symbols``."""

    def __init__(self, symbols: list[Symbol]) -> None:
        axis = (np.arange(SIDE) + 0.5) / SIDE * 2.0 * REACH - REACH
        self.x, self.y = (a.ravel() for a in np.meshgrid(axis, axis))
        models = [self._model(symbol) for symbol in symbols]
        self.masks: Image = np.array([mask for _, mask in models], dtype=np.float32)
        """(symbols, SIDE * SIDE)"""
        pictures = np.array([columns[:, 0] for columns, _ in models])
        pictures -= (pictures * self.masks).sum(axis=1, keepdims=True) / self.masks.sum(axis=1, keepdims=True)
        pictures *= self.masks
        self.pictures: Image = (pictures / np.linalg.norm(pictures, axis=1, keepdims=True)).astype(np.float32)
        """(symbols, SIDE * SIDE), mean 0 and norm 1 where ``masks``, 0 elsewhere"""
        self._inside = np.flatnonzero(self.masks.any(axis=0))
        """samples near any of the symbols: those that are aligned"""
        self._near = np.ascontiguousarray(self.masks[:, self._inside])
        inside = [columns[self._inside] for columns, _ in models]
        self._columns: Image = np.hstack(inside).astype(np.float32)
        self._squares: Image = np.hstack(
            [(columns[:, :, None] * columns[:, None]).reshape(len(columns), -1) for columns in inside]
        ).astype(np.float32)
        self._solvers: Image = np.vstack([np.linalg.pinv(columns) for columns in inside]).T.astype(np.float32)
        self._light: Image = np.column_stack([self.x, self.y, np.ones(len(self.x))]).T.astype(np.float32)

    def _model(self, symbol: Symbol) -> tuple[Array, NDArray[np.bool_]]:
        """(SIDE * SIDE, 8): what a patch is made of near the symbol: gain, offset, slopes, and gain * (x, y, angle, log
        scale); and where that is.
        """
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
        for step in range(steps):
            patches = sample(picture, middles, affines, self.x[self._inside], self.y[self._inside])
            found = self._solved(patches, which)
            if step == steps - 1:
                found = self._fitted(patches, which, self._weighed(patches, which, found))
            gain = np.maximum(found[:, :1], 2.0)  # nothing there: no step
            move = np.clip(found[:, 4:] / gain, -STEP, STEP)
            middles = middles + np.einsum("nij,nj->ni", affines, move[:, :2])
            affines = affines @ turned(move[:, 2], np.exp(move[:, 3]))
        return middles, affines

    def _solved(self, patches: Image, which: NDArray[np.intp]) -> Array:
        """(N, 8): the model's coefficients, by the samples near the symbol."""
        found = (patches @ self._solvers).reshape(len(which), len(self.masks), -1)
        return found[np.arange(len(which)), which].astype(float)

    def _fitted(self, patches: Image, which: NDArray[np.intp], weights: Image) -> Array:
        """The same of weighted samples."""
        count, order = np.arange(len(which)), self._columns.shape[1] // len(self.masks)
        normal = (weights @ self._squares).reshape(len(which), -1, order, order)[count, which].astype(float)
        right = ((weights * patches) @ self._columns).reshape(len(which), -1, order)[count, which].astype(float)
        found: Array = np.linalg.solve(normal + RIDGE * np.eye(order), right[..., None])[..., 0]
        return found

    def _weighed(self, patches: Image, which: NDArray[np.intp], found: Array) -> Image:
        """The samples' weights: what is far from the model, as what hides a part of the symbol is, counts less."""
        spread = np.zeros((len(which), len(self.masks), found.shape[1]), dtype=np.float32)
        spread[np.arange(len(which)), which] = found
        near = self._near[which]
        off = (patches - spread.reshape(len(which), -1) @ self._columns.T) * near
        typical = np.abs(off).sum(axis=1, keepdims=True) / near.sum(axis=1, keepdims=True) + NOISE
        return np.asarray(near / (1.0 + (off / (DOUBTED * typical)) ** 2), dtype=np.float32)

    def standard(self, patches: Image, which: NDArray[np.intp]) -> Image:
        """(N, SIDE * SIDE): bare ground at 0 and paint at 1, the light's slope undone; from -2 to 3, whatever is there.
        Where there is no contrast the noise has at most that of a symbol's.
        """
        near = np.ascontiguousarray(patches[:, self._inside])
        found = self._fitted(near, which, self._weighed(near, which, self._solved(near, which)))
        light = found[:, [2, 3, 1]].astype(np.float32) @ self._light
        gain = np.maximum(found[:, :1], LEAST_GAIN).astype(np.float32)
        result: Image = np.clip((patches - light) / gain, -2.0, 3.0)
        return result

    def correlation(self, patches: Image) -> Array:
        """(N, symbols): of patches with each of the symbols near it."""
        count = self.masks.sum(axis=1)
        mean = patches @ self.masks.T / count
        power = np.maximum((patches * patches) @ self.masks.T - count * mean * mean, 0.0)
        return np.asarray(patches @ self.pictures.T / np.sqrt(power + NOISE * NOISE * count), dtype=float)


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
