"""What stands on a pad, as exact shapes: the letter H and those that could be taken for it.

A letter lies in the plane with its upright along +y; one unit is its height, its middle is the origin. Every function
takes coordinates of any shape and gives, for each of them, whether ink lies there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Bar = tuple[float, float, float, float]
"""of a straight stroke: the two ends of its middle line"""

LOOKALIKES = ("N", "A", "X", "+", "O", "E", "T", "U", "Z", "I", "II", "L", "F", "M", "W", "K", "Y", "V", "4")


def ink(letter: str, x: Array, y: Array, width: float, stroke: float) -> Mask:
    """Whether (x, y) lies on ``letter``, ``width`` by 1 with strokes of ``stroke``; a glyph has its own."""
    if ":" in letter:
        from tests.agents.helipad import typefaces

        return typefaces.ink(letter, *np.broadcast_arrays(x, y))
    if letter == "O":
        outer = (x / (width / 2.0)) ** 2 + (y / 0.5) ** 2 <= 1.0
        inner = (x / (width / 2.0 - stroke)) ** 2 + (y / (0.5 - stroke)) ** 2 <= 1.0
        return outer & ~inner
    covered = np.zeros(np.broadcast(x, y).shape, dtype=bool)
    for bar in _bars(letter, width, stroke):
        covered |= _on_bar(x, y, bar, stroke)
    return covered & (np.abs(x) <= width / 2.0) & (np.abs(y) <= 0.5)


def _bars(letter: str, width: float, stroke: float) -> list[Bar]:
    side = (width - stroke) / 2.0  # of an upright's middle line
    level = 0.5 - stroke / 2.0  # of the top bar's
    left, right = (-side, -1.0, -side, 1.0), (side, -1.0, side, 1.0)
    top, middle, foot = (-1.0, level, 1.0, level), (-1.0, 0.0, 1.0, 0.0), (-1.0, -level, 1.0, -level)
    rising, falling = (-side, -level, side, level), (-side, level, side, -level)
    stem = (0.0, -1.0, 0.0, 1.0)
    return {
        "H": [left, right, middle],
        "N": [left, right, falling],
        "A": [(-side, -0.5, 0.0, 0.5), (side, -0.5, 0.0, 0.5), (-side, -0.12, side, -0.12)],
        "X": [rising, falling],
        "+": [stem, middle],
        "E": [left, top, middle, foot],
        "T": [stem, top],
        "U": [left, right, foot],
        "Z": [top, foot, rising],
        "I": [stem],
        "II": [left, right],
        "L": [left, foot],
        "F": [left, top, middle],
        "M": [left, right, (-side, 0.5, 0.0, -0.1), (side, 0.5, 0.0, -0.1)],
        "W": [left, right, (-side, -0.5, 0.0, 0.1), (side, -0.5, 0.0, 0.1)],
        "K": [left, (-side, 0.0, side, level), (-side, 0.0, side, -level)],
        "Y": [(0.0, -0.5, 0.0, 0.0), (-side, level, 0.0, 0.0), (side, level, 0.0, 0.0)],
        "V": [(-side, 0.5, 0.0, -0.5), (side, 0.5, 0.0, -0.5)],
        "4": [right, middle, (-side, 0.0, -side, 0.5)],
    }[letter]


def _on_bar(x: Array, y: Array, bar: Bar, stroke: float) -> Mask:
    """Within half a stroke of the line through the bar's ends and, for slanted bars, not far past them."""
    x0, y0, x1, y1 = bar
    length = math.hypot(x1 - x0, y1 - y0)
    if y0 == y1 and x1 > x0:
        return _between(y, y0 - stroke / 2.0, y0 + stroke / 2.0) & _between(x, x0 - stroke, x1 + stroke)
    if x0 == x1 and y1 > y0:
        return _between(x, x0 - stroke / 2.0, x0 + stroke / 2.0) & _between(y, y0 - stroke, y1 + stroke)
    along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length
    across = ((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length
    near = np.abs(across) <= stroke / 2.0
    return near & (along >= -stroke) & (along <= length + stroke)


def _between(value: Array, low: float, high: float) -> Mask:
    return (value >= low) & (value <= high)
