"""From a frame to the scalar pictures that are searched, and from these to smaller ones.

Paint for landing pads is white or yellow. Grey shows either on most grounds, with the least noise and without JPEG's
coarse colours. Where it does not, on light or equally bright ground, yellow paint stands out in what is common to red
and green and missing in blue.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput

Picture = NDArray[np.uint8]
"""(height, width), one channel"""
LEAST_YELLOW = 40
"""steps of 8 bits above the median; paler things than that are no paint"""


def check_frame(frame: object) -> Picture:
    """``frame`` as it is where it is one: (height, width, 3) BGR or (height, width), 8 bits, 16 pixels or more each way.
    Raises :class:`BadInput`.
    """
    expected = "(height, width, 3) BGR or (height, width), uint8, at least 16 x 16"
    if not isinstance(frame, np.ndarray):
        raise _bad(type(frame).__name__, expected)
    color = frame.ndim == 3 and frame.shape[2] == 3
    if frame.dtype != np.uint8 or not (color or frame.ndim == 2) or min(frame.shape[:2]) < 16:
        raise _bad(f"{frame.dtype} {frame.shape}", expected)
    return frame


def grey(frame: Picture) -> Picture:
    """(height, width): intensity."""
    if frame.ndim == 2:
        return frame
    return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def yellow(frame: Picture) -> Picture | None:
    """(height, width): min(red, green) - blue, not below 0; None where nothing in the frame is yellow paint."""
    if frame.ndim == 2:
        return None
    small = frame[::4, ::4].astype(np.int16)
    if not np.any(np.minimum(small[..., 1], small[..., 2]) - small[..., 0] > LEAST_YELLOW):
        return None
    blue, green, red = cv2.split(frame)
    return np.asarray(cv2.subtract(cv2.min(green, red), blue), dtype=np.uint8)


def shrink(picture: Picture, factor: float) -> tuple[Picture, tuple[float, float]]:
    """``picture`` about ``factor`` (at most 1) times as large, averaged, and the exact factors across and down.

    A pixel u of the one is at (u + 0.5) * factor - 0.5 in the other.
    """
    height, width = picture.shape
    if factor >= 1.0:
        return picture, (1.0, 1.0)
    size = (max(round(width * factor), 8), max(round(height * factor), 8))
    whole = max(int(1.0 / factor + 1e-6), 1)
    if whole > 1:  # INTER_LINEAR looks at two pixels only, and INTER_AREA is quick for whole numbers only
        picture = np.asarray(
            cv2.resize(picture, (max(width // whole, 8), max(height // whole, 8)), interpolation=cv2.INTER_AREA),
            dtype=np.uint8,
        )
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    return small, (size[0] / width, size[1] / height)


def _bad(value: object, expected: str) -> BadInput:
    return BadInput(f"frame is {value}; expected {expected}", field="frame", value=str(value), expected=expected)
