"""How much of each texel a shape covers, 0 to 1: drawings without jagged edges at any scale, however small.

Coordinates are metres in the shape's own axes; ``s`` is a texel's side. Boxes are exact for texels that lie along their
axes, discs where they are larger than a texel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.floating[Any]]


def span(x: Grid, low: float, high: float, s: float) -> Grid:
    """Share of the texels [x - s/2, x + s/2] that lies between ``low`` and ``high``."""
    inside = np.minimum(x + 0.5 * s, high) - np.maximum(x - 0.5 * s, low)
    result: Grid = np.clip(inside / s, 0.0, 1.0)
    return result


def box(x: Grid, y: Grid, half_x: float, half_y: float, s: float) -> Grid:
    """A rectangle about the origin."""
    return span(x, -half_x, half_x, s) * span(y, -half_y, half_y, s)


def dashes(x: Grid, period: float, length: float, s: float) -> Grid:
    """Share of each texel on a dash: dashes of ``length`` begin at every multiple of ``period``."""

    def covered(at: Grid) -> Grid:
        whole = np.floor(at / period)
        result: Grid = whole * length + np.minimum(at - whole * period, length)
        return result

    result: Grid = (covered(x + 0.5 * s) - covered(x - 0.5 * s)) / s
    return result


def disc(x: Grid, y: Grid, radius: float, s: float) -> Grid:
    """A disc about the origin; one smaller than a texel counts with its area."""
    blur = max(s, 1e-9)
    soft = np.clip(0.5 + (radius - np.sqrt(x * x + y * y)) / blur, 0.0, 1.0)
    strength = min(1.0, math.pi * radius * radius / (blur * blur))
    result: Grid = soft * np.float32(strength)
    return result


def turned(north: Grid, east: Grid, center: tuple[float, float], heading: float) -> tuple[Grid, Grid]:
    """Metres along ``heading`` (radians) from ``center``, and across it to the right."""
    c, sn = np.float32(math.cos(heading)), np.float32(math.sin(heading))
    dn, de = north - np.float32(center[0]), east - np.float32(center[1])
    return dn * c + de * sn, de * c - dn * sn


def over(below: Grid, alpha: Grid, color: Grid | tuple[float, float, float]) -> None:
    """Paint ``color`` with ``alpha`` (h, w) over ``below`` (h, w, 3), in place."""
    rows = np.flatnonzero(alpha.any(1))
    if not rows.size:
        return
    part = slice(rows[0], rows[-1] + 1)  # most of the picture is often not painted at all
    paint = np.asarray(color, dtype=np.float32)
    paint = paint[part] if paint.ndim == 3 else paint
    below[part] += (paint - below[part]) * alpha[part, :, None]
