"""Symbols as pictures: the letter H in a few proportions.

A symbol's coordinates have their origin in its middle and its height as the unit; x is right and y down.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Bar = tuple[float, float, float, float]
"""a stroke's middle line from (x, y) to (x, y); width: the letter's"""

PIXELS = 96
"""of a symbol's height in its picture"""
MARGIN = 0.5
"""of nothing about the symbol in its picture, in heights"""
BLUR = 0.05
"""standard deviation, in heights: what lens and sampling leave of an edge at the working scale"""
PROPORTIONS = ((0.6, 0.15), (0.7, 0.18), (0.8, 0.21))
"""width and stroke of an H, of its height; ICAO's is the narrow one, small pads have bolder ones"""


class Symbol:
    """A symbol that can be looked up at any point; ``picture`` is (height, width), 1 where it is painted.

    ``half`` is half its width and half its height, in heights.
    """

    def __init__(self, picture: Image) -> None:
        height, width = picture.shape
        self.half = (0.5 * width / height, 0.5)
        size = (max(round(PIXELS * width / height), 3), PIXELS)
        edge = round(MARGIN * PIXELS)
        shrunk = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        framed = cv2.copyMakeBorder(shrunk, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=(0.0,))
        self._picture: Image = np.asarray(cv2.GaussianBlur(framed, (0, 0), BLUR * PIXELS), dtype=np.float32)

    def at(self, x: Array, y: Array) -> Array:
        """How much paint there is at (x, y), of their shape; 0 outside."""
        height, width = self._picture.shape
        u = (x * PIXELS + (width - 1) / 2.0).astype(np.float32)
        v = (y * PIXELS + (height - 1) / 2.0).astype(np.float32)
        flat = cv2.remap(self._picture, u.reshape(1, -1), v.reshape(1, -1), cv2.INTER_LINEAR)
        return np.asarray(flat, dtype=float).reshape(x.shape)

    def near(self, x: Array, y: Array, margin: float = 0.15) -> NDArray[np.bool_]:
        """Which (x, y) lie on the symbol's rectangle or not farther than ``margin`` from it."""
        result: NDArray[np.bool_] = (np.abs(x) <= self.half[0] + margin) & (np.abs(y) <= self.half[1] + margin)
        return result


def letter_h() -> list[Symbol]:
    """The built-in H in its proportions. It is its own mirror image: seen mirrored, it is found as it is."""
    result = []
    for width, stroke in PROPORTIONS:
        side = (width - stroke) / 2.0
        bars = [(-side, -0.5, -side, 0.5), (side, -0.5, side, 0.5), (-side, 0.0, side, 0.0)]
        result.append(Symbol(_drawn(bars, width, stroke)))
    return result


def _drawn(bars: list[Bar], width: float, stroke: float) -> Image:
    """Strokes with square ends, cut to ``width`` by 1; PIXELS * 4 high."""
    fine = 4 * PIXELS
    v, u = np.mgrid[0:fine, 0 : round(fine * width)]
    x, y = (u + 0.5) / fine - width / 2.0, (v + 0.5) / fine - 0.5
    result = np.zeros(x.shape, dtype=np.float32)
    for x0, y0, x1, y1 in bars:
        length = math.hypot(x1 - x0, y1 - y0)
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length
        across = ((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length
        result[(np.abs(across) <= stroke / 2.0) & (np.abs(along - length / 2.0) <= (length + stroke) / 2.0)] = 1.0
    return result
