"""From a frame to the scalar pictures that are searched, and from these to smaller ones.

Paint for landing pads is white or yellow. Grey shows either on most grounds, with the least noise and without JPEG's
coarse colours. Where it does not, on light or equally bright ground, yellow paint stands out in what is common to red
and green and missing in blue.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput

Picture = NDArray[np.uint8]
"""(height, width), one channel"""
LESS_BLUE = 0.3
LEAST_YELLOW = 40
"""steps of 8 bits; paler things than that are no paint"""
STRIDE = 3
"""pixels between those that are looked at for yellow"""
LEAST_ABOUT = 16
"""pixels about the yellow that are searched with it; and a third of its extent"""


def check_frame(frame: object) -> Picture:
    """``frame`` as it is where it is one: (height, width, 3) BGR or (height, width), 8 bits, at least 16 x 16. Raises
    :class:`BadInput`.
    """
    expected = "(height, width, 3) BGR or (height, width), uint8, at least 16 x 16"
    if not isinstance(frame, np.ndarray):
        raise _bad(type(frame).__name__, expected)
    color = frame.ndim == 3 and frame.shape[2] == 3
    if frame.dtype != np.uint8 or not (color or frame.ndim == 2) or min(frame.shape[:2]) < 16:
        raise _bad(f"{frame.dtype} {frame.shape}", expected)
    return frame


def grey(frame: Picture) -> Picture:
    """(height, width): intensity; of a frame with colour a little less of what is blue, so that yellow paint is about
    as bright as white paint is.
    """
    if frame.ndim == 2:
        return frame
    intensity = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    blue = cv2.extractChannel(frame, 0)
    return np.asarray(cv2.addWeighted(intensity, 1.0 + LESS_BLUE, blue, -LESS_BLUE, 0.0), dtype=np.uint8)


def yellow(frame: Picture) -> tuple[Picture, tuple[int, int]] | None:
    """min(red, green) - blue, not below 0, of the part of ``frame`` that has yellow paint in it, and that part's first
    pixel (u, v); None where nothing is yellow paint.
    """
    if frame.ndim == 2:
        return None
    blue, green, red = cv2.split(np.ascontiguousarray(frame[::STRIDE, ::STRIDE]))
    least = cv2.threshold(cv2.subtract(cv2.min(green, red), blue), LEAST_YELLOW, 255.0, cv2.THRESH_BINARY)[1]
    u, v, width, height = cv2.boundingRect(least)
    if not width:
        return None
    u, v, right, foot = (STRIDE * i for i in (u, v, u + width, v + height))
    about = LEAST_ABOUT + max(right - u, foot - v) // 3
    u, v = max(u - about, 0), max(v - about, 0)
    blue, green, red = cv2.split(frame[v : foot + about, u : right + about])
    return np.asarray(cv2.subtract(cv2.min(green, red), blue), dtype=np.uint8), (u, v)


class Pyramid:
    """A scalar picture, and smaller ones of it; ``origin`` (2,) is where its first pixel is in the frame."""

    def __init__(self, picture: Picture, origin: tuple[int, int] = (0, 0)) -> None:
        self.origin: NDArray[np.float64] = np.array(origin, dtype=float)
        self.whole = picture
        self._halves = [picture]
        self.size = picture.shape[1], picture.shape[0]
        """width and height, pixels"""

    def shrunk(self, factor: float) -> tuple[Picture, NDArray[np.float64]]:
        """The picture about ``factor`` times as large (never larger than it is), averaged, and the exact factors (2,)
        across and down. A pixel u of the frame is at (u - origin + 0.5) * factor - 0.5 in it.
        """
        picture, whole = self._half(factor)
        height, width = picture.shape
        rest = factor / whole
        if rest > 0.95:
            return picture, np.array([whole, whole])
        size = (max(round(width * rest), 8), max(round(height * rest), 8))
        small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        return small, np.array([whole * size[0] / width, whole * size[1] / height])

    def warped(self, matrix: NDArray[np.float64], size: tuple[int, int], factor: float) -> Picture:
        """The picture seen through ``matrix`` (3, 3), from a pixel of the result, ``size`` wide and high, to one of the
        frame; ``factor``: pixels of the result for one of the frame. Edges are continued.
        """
        picture, whole = self._half(factor)
        u, v = self.origin
        to_half = np.array(
            [[whole, 0.0, (0.5 - u) * whole - 0.5], [0.0, whole, (0.5 - v) * whole - 0.5], [0.0, 0.0, 1.0]]
        )
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        found = cv2.warpPerspective(picture, to_half @ matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, dtype=np.uint8)

    def _half(self, factor: float) -> tuple[Picture, float]:
        """The smallest half of a half ... that is not below ``factor``, which INTER_LINEAR then takes further: it looks
        at two pixels only.
        """
        level = max(int(math.log2(1.0 / factor) + 1e-6), 0) if factor < 1.0 else 0
        while len(self._halves) <= level and min(self._halves[-1].shape) >= 16:
            height, width = self._halves[-1].shape
            even = self._halves[-1][: height // 2 * 2, : width // 2 * 2]
            half = cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
            self._halves.append(np.asarray(half, dtype=np.uint8))
        level = min(level, len(self._halves) - 1)
        return self._halves[level], 0.5**level


def _bad(value: object, expected: str) -> BadInput:
    return BadInput.wrong("frame", str(value), expected, f"frame is {value}")
