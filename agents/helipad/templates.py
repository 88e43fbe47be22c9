"""Symbols as pictures: the letter H in a few proportions, other letters that must not pass for it, and files.

A symbol's coordinates have their origin in its middle and its height as the unit; x is right and y down.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput

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


def competitors(symbols: list[Symbol]) -> list[Symbol]:
    """Other letters and signs; none that looks like one of ``symbols`` itself."""
    width, stroke = 0.7, 0.18
    side, level = (width - stroke) / 2.0, 0.5 - stroke / 2.0
    left, right = (-side, -0.5, -side, 0.5), (side, -0.5, side, 0.5)
    top, middle, foot = (-side, -level, side, -level), (-side, 0.0, side, 0.0), (-side, level, side, level)
    stem = (0.0, -0.5, 0.0, 0.5)
    ring = [
        (math.cos(a) * side, math.sin(a) * level, math.cos(a + 0.3) * side, math.sin(a + 0.3) * level)
        for a in np.arange(0.0, 2.0 * math.pi, 0.25)
    ]
    drawings: list[list[Bar]] = [
        [left, right, middle],
        [left, right, (-side, -level, side, level)],
        [left, right, (-side, level, side, -level)],
        [(-side, 0.5, 0.0, -0.5), (side, 0.5, 0.0, -0.5), (-side * 0.6, 0.15, side * 0.6, 0.15)],
        [(-side, -level, side, level), (-side, level, side, -level)],
        [stem, middle],
        ring,
        [left, top, middle, foot],
        [stem, top],
        [left, right, foot],
        [top, foot, (side, -level, -side, level)],
        [stem],
        [left, right],
        [left, foot],
        [left, top, middle],
    ]
    y, x = np.mgrid[-0.7:0.7:29j, -0.7:0.7:29j]
    found = []
    for bars in drawings:
        other = Symbol(_drawn(bars, width, stroke))
        picture = other.at(x, y)
        if all(_alike(picture, s.at(x, y)) < 0.97 for s in symbols):
            found.append(other)
    return found


def load(path: str | Path) -> Symbol:
    """The symbol of a template file: a grey picture (PNG or another format that OpenCV reads), white on black, cut to
    the symbol: its height is the symbol's. At least 8 pixels each way and not all alike; not more than 3 times as wide
    as high. Raises :class:`BadInput`.
    """
    file = Path(path)
    if not file.is_file():
        raise _bad(path, "a picture file that is there")
    picture = cv2.imdecode(np.frombuffer(file.read_bytes() or b"\0", dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise _bad(path, "a PNG or another picture that OpenCV reads")
    height, width = picture.shape
    if min(height, width) < 8 or width > 3 * height or height > 3 * width:
        raise _bad(f"{path} ({width} x {height})", "8 pixels or more each way, at most 3 times as long as wide")
    ink = picture.astype(np.float32) / 255.0
    if float(ink.max() - ink.min()) < 0.5 or not 0.02 < float(ink.mean()) < 0.95:
        raise _bad(path, "a white symbol on black")
    return Symbol(ink)


def turns_alike(symbol: Symbol) -> bool:
    """Whether it looks the same after half a turn, as an H does."""
    y, x = np.mgrid[-0.7:0.7:29j, -0.7:0.7:29j]
    return _alike(symbol.at(x, y), symbol.at(-x, -y)) > 0.95


def _alike(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / math.sqrt((a * a).sum() * (b * b).sum()))


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


def _bad(value: object, expected: str) -> BadInput:
    return BadInput(
        f"template is {str(value)!r}; expected {expected}", field="template", value=str(value), expected=expected
    )
