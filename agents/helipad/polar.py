"""Polar patches about candidates, and their correlation with symbols over shifts and scales in one matrix product."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad.channels import Picture
from agents.helipad.templates import Symbol

Array = NDArray[np.float64]
Image = NDArray[np.float32]

ANGLES = 32
RINGS = np.arange(0.04, 0.70, 0.08)
"""radii, in heights of the symbol"""
NOISE = 1.5
"""standard deviation in steps of 8 bits, added to a patch's own"""


def grid() -> tuple[Array, Array]:
    """x and y of a patch's samples, each (rings * angles,), in heights of the symbol; the angle turns clockwise."""
    turn = np.arange(ANGLES) * 2.0 * math.pi / ANGLES
    return (RINGS[:, None] * np.sin(turn)).ravel(), (-RINGS[:, None] * np.cos(turn)).ravel()


def weights() -> Array:
    """(rings * angles,): the root of the area that a sample stands for."""
    return np.repeat(np.sqrt(RINGS / RINGS.mean()), ANGLES)


def sample(picture: Picture, middles: Array, affines: Array, x: Array, y: Array) -> Image:
    """(N, M): ``picture`` about (N, 2) ``middles`` at the offsets (M,) ``x``, ``y``, which ``affines`` (N, 2, 2) take
    to pixels; edges are continued.
    """
    a = affines.astype(np.float32)
    m = middles.astype(np.float32)
    xy = np.stack([x, y]).astype(np.float32)
    u = a[:, 0] @ xy + m[:, :1]
    v = a[:, 1] @ xy + m[:, 1:]
    flat = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(flat, dtype=np.float32).reshape(len(middles), -1)


def normalised(patches: Image, weight: Image) -> Image:
    """(N, M) of weighted mean 0 and norm about 1, below that where there is hardly more than noise."""
    level = (patches @ (weight * weight))[:, None] / float(weight @ weight)
    leaning = (patches - level) * weight
    norm = np.sqrt(np.einsum("nm,nm->n", leaning, leaning) + NOISE * NOISE * len(weight))
    result: Image = (leaning / norm[:, None]).astype(np.float32)
    return result


class Bank:
    """Polar templates of symbols at ``scales`` (of the expected height) over cyclic shifts of half a turn, after which
    each is the same again: the two halves of a patch are added first.
    """

    def __init__(self, symbols: list[Symbol], scales: tuple[float, ...]) -> None:
        x, y = grid()
        self.weight: Image = weights().astype(np.float32)
        self.shifts = ANGLES // 2
        self.scales = scales
        columns = []
        for symbol in symbols:
            for scale in scales:
                patch = (symbol.at(x / scale, y / scale)).reshape(len(RINGS), ANGLES)
                columns += [np.roll(patch, shift, axis=1).ravel() for shift in range(self.shifts)]
        table = np.array(columns, dtype=np.float32)
        table -= (table @ (self.weight**2))[:, None] / float(self.weight @ self.weight)
        table *= self.weight
        table /= np.linalg.norm(table, axis=1)[:, None]
        halves = table.reshape(len(table), len(RINGS), 2, self.shifts)
        self.table: Image = np.ascontiguousarray(halves.mean(axis=2).reshape(len(table), -1).T)

    def match(self, patches: Image) -> tuple[Array, NDArray[np.intp], Array, Array]:
        """Of (N, M) normalised patches: the best correlation (N,), which symbol (N,), its scale and its angle (N,)."""
        halves = patches.reshape(len(patches), len(RINGS), 2, self.shifts)
        products = halves.sum(axis=2).reshape(len(patches), -1) @ self.table
        best = products.argmax(axis=1)
        symbol, rest = np.divmod(best, len(self.scales) * self.shifts)
        scale, shift = np.divmod(rest, self.shifts)
        value = products[np.arange(len(best)), best].astype(float)
        return value, symbol, np.array(self.scales)[scale], shift * (2.0 * math.pi / ANGLES)
