"""Capital letters and digits of real typefaces, for pads that are none: OpenCV's Hershey fonts and matplotlib's.

A glyph is named "face:character" and is used as a letter of :mod:`letters` is: its height is the unit. A face of
Hershey's may have the pixels of its stroke: "TRIPLEX-14:M". A face that is a path is the font in that file.
"""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

CHARACTERS = "ABCDEFGIJKLMNOPQRSTUVWXYZ0123456789"
"""without H"""
LEARNED = (
    *(f"{face}{stroke}" for face in ("TRIPLEX", "PLAIN") for stroke in ("-14", "", "-38")),
    *("STIXGeneral", "STIXGeneralBol", "cmss10", "cmtt10", "cmb10", "cmr10"),
)
"""faces that the learned check has seen"""
JUDGED = ("SIMPLEX", "DUPLEX", "COMPLEX", "DejaVuSans", "DejaVuSerif", "DejaVuSansMono-Bold")
"""faces that the bench judges by; of these the learned check has seen words of SIMPLEX and DUPLEX in clutter"""
TALL, STROKE = 200, 26
"""pixels of a glyph, and of a Hershey font's stroke"""
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"


def names(faces: tuple[str, ...], characters: str = CHARACTERS) -> list[str]:
    return [f"{face}:{each}" for face in faces for each in characters]


@functools.lru_cache(maxsize=1000)
def glyph(name: str) -> NDArray[np.bool_]:
    """(height, width): where ink is, cut to the ink."""
    face, _, character = name.rpartition(":")
    path = Path(face) if face.endswith(".ttf") else FONTS / f"{face}.ttf"
    if path.exists():
        canvas = Image.new("L", (4 * TALL, 4 * TALL))
        font = ImageFont.truetype(str(path), TALL)
        ImageDraw.Draw(canvas).text((TALL, TALL), character, 255, font)
        drawn = np.asarray(canvas)
    else:
        drawn = np.zeros((4 * TALL, 4 * TALL), dtype=np.uint8)
        face, _, stroke = face.partition("-")
        font_face = getattr(cv2, f"FONT_HERSHEY_{face}")
        scale = cv2.getFontScaleFromHeight(font_face, TALL)
        cv2.putText(drawn, character, (TALL, 3 * TALL), font_face, scale, (255.0,), int(stroke or STROKE), cv2.LINE_AA)
    inked = drawn > 127
    rows, columns = np.flatnonzero(inked.any(axis=1)), np.flatnonzero(inked.any(axis=0))
    result: NDArray[np.bool_] = inked[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return result


def ink(name: str, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether (x, y), y upwards, lies on the glyph, whose middle is the origin."""
    drawn = glyph(name)
    height, width = drawn.shape
    u = np.floor(x * height + width / 2.0).astype(int)
    v = np.floor((0.5 - y) * height).astype(int)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    result: NDArray[np.bool_] = inside & drawn[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return result
