"""OpenCV where it is needed: an extra, so that a vehicle which sees nothing need not carry it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadConfig, BadInput

Image = NDArray[np.uint8]
"""(height, width, 3) BGR"""


def opencv() -> Any:
    """The module ``cv2``; raises :class:`BadConfig` where it is not installed."""
    try:
        import cv2
    except ImportError as e:
        raise BadConfig(
            "pictures need OpenCV, which is not installed: pip install 'zmav[vision]'",
            field="vision", value=None, expected="opencv-python-headless 4.10 or newer",
        ) from e  # fmt: skip
    return cv2


def decode(jpeg: bytes) -> Image:
    """(height, width, 3) BGR of a JPEG; raises :class:`BadInput` for what is none."""
    cv2 = opencv()
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) if jpeg else None
    if image is None:
        raise BadInput(f"{len(jpeg)} bytes are no picture", field="jpeg", value=len(jpeg), expected="a JPEG")
    found: Image = image
    return found


def encode(image: Image, quality: int) -> bytes:
    """A JPEG of (height, width, 3) BGR; ``quality`` 1 to 100."""
    cv2 = opencv()
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    jpeg: bytes = data.tobytes()
    return jpeg
