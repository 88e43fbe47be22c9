"""OpenCV where it is needed: an extra, so that a vehicle which sees nothing need not carry it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput, missing_extra

MOST_PIXELS = 8192
"""of a picture's side"""
Image = NDArray[np.uint8]
"""(height, width, 3) BGR"""


def opencv() -> Any:
    """The module ``cv2``; raises :class:`BadConfig` where it is not installed."""
    try:
        import cv2
    except ImportError as e:
        raise missing_extra("a picture", "OpenCV", "vision") from e
    return cv2


def decode(jpeg: bytes) -> Image:
    """(height, width, 3) BGR of a JPEG; raises :class:`BadInput` for what is none, or larger than any camera's."""
    cv2 = opencv()
    width, height = jpeg_size(jpeg)
    if max(width, height) > MOST_PIXELS:
        text = f"a picture of {width}x{height}; at most {MOST_PIXELS} a side are read"
        raise BadInput(text, field="jpeg", value=[width, height], expected=f"at most {MOST_PIXELS} pixels a side")
    try:
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise _no_picture(jpeg)
    found: Image = image
    return found


def jpeg_size(jpeg: bytes) -> tuple[int, int]:
    """Width and height by the JPEG's frame header (ITU-T T.81, B.2.2); raises :class:`BadInput` where it has none."""
    at = 2
    while jpeg[:2] == b"\xff\xd8" and at + 9 <= len(jpeg) and jpeg[at] == 0xFF:
        marker = jpeg[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(jpeg[at + 7 : at + 9], "big"), int.from_bytes(jpeg[at + 5 : at + 7], "big")
        at += 1 if marker == 0xFF else 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    raise _no_picture(jpeg)


def _no_picture(jpeg: bytes) -> BadInput:
    return BadInput(f"{len(jpeg)} bytes are no picture", field="jpeg", value=len(jpeg), expected="a JPEG")


def encode(image: Image, quality: int) -> bytes:
    """A JPEG of (height, width, 3) BGR; ``quality`` 1 to 100."""
    cv2 = opencv()
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    jpeg: bytes = data.tobytes()
    return jpeg
