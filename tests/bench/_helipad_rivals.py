"""What else finds a landing pad in a frame: the paper's chain done plainly, matchTemplate, and OpenCV's AprilTags."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Image = NDArray[np.float32]

RINGS = 14
RAYS = 36
ALIKE = 0.85
"""correlation of rings, and of rays"""
TEMPLATE_SCALES = (0.88, 1.0, 1.14)
ROTATIONS = 18
MATCH = 0.62


class Seen(NamedTuple):
    u: float
    v: float
    heading: float | None
    score: float


def drawn_h(side: int) -> Frame:
    """(2 side, 2 side): an H ``side`` pixels high in the middle."""
    picture = np.zeros((2 * side, 2 * side), dtype=np.uint8)
    left, width, stroke = round(0.65 * side), round(0.7 * side), max(round(0.18 * side), 1)
    top, foot = side // 2, side // 2 + side
    picture[top:foot, left : left + stroke] = 255
    picture[top:foot, left + width - stroke : left + width] = 255
    picture[side - stroke // 2 : side - stroke // 2 + stroke, left : left + width] = 255
    return picture


class Naive:
    """Coombes et al. 2014: a threshold for the whole picture (Otsu's), blobs, then at each blob's centroid the means on
    rings over scales and along rays over shifts, sample by sample.
    """

    def __init__(self) -> None:
        self._side = 48
        picture = drawn_h(self._side).astype(np.float32) / 255.0
        middle = (picture.shape[0] - 1) / 2.0
        self._rings = [self._ring(picture, middle, middle, 0.72 * self._side * (i + 0.5) / RINGS) for i in range(RINGS)]
        self._rays = [self._ray(picture, middle, middle, 0.6 * self._side, i) for i in range(RAYS)]

    def find(self, frame: Frame, scale_px: float) -> list[Seen]:
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        _, binary = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        _, _, stats, centroids = cv2.connectedComponentsWithStats(binary)
        picture = binary.astype(np.float32) / 255.0
        found = []
        for stat, (u, v) in zip(stats[1:], centroids[1:], strict=True):
            if not 20 <= stat[4] <= 20_000:
                continue
            best, height = -1.0, 0.0
            for step in range(-2, 3):
                tall = scale_px * 1.1**step
                rings = [self._ring(picture, u, v, 0.72 * tall * (i + 0.5) / RINGS) for i in range(RINGS)]
                alike = _correlation(rings, self._rings)
                if alike > best:
                    best, height = alike, tall
            if best < ALIKE:
                continue
            rays = [self._ray(picture, u, v, 0.6 * height, i) for i in range(RAYS)]
            turns = [_correlation(rays[shift:] + rays[:shift], self._rays) for shift in range(RAYS // 2)]
            shift = max(range(RAYS // 2), key=lambda i: turns[i])
            if turns[shift] >= ALIKE:
                found.append(Seen(float(u), float(v), 2.0 * math.pi * shift / RAYS % math.pi, best * turns[shift]))
        return sorted(found, key=lambda s: -s.score)

    @staticmethod
    def _at(picture: Image, u: float, v: float) -> float:
        x, y = round(u), round(v)
        inside = 0 <= y < picture.shape[0] and 0 <= x < picture.shape[1]
        return float(picture[y, x]) if inside else 0.0

    def _ring(self, picture: Image, u: float, v: float, radius: float) -> float:
        total = 0.0
        for i in range(RAYS):
            angle = 2.0 * math.pi * i / RAYS
            total += self._at(picture, u + radius * math.sin(angle), v - radius * math.cos(angle))
        return total / RAYS

    def _ray(self, picture: Image, u: float, v: float, reach: float, number: int) -> float:
        angle = 2.0 * math.pi * number / RAYS
        total = 0.0
        for i in range(RINGS):
            radius = reach * (i + 0.5) / RINGS
            total += self._at(picture, u + radius * math.sin(angle), v - radius * math.cos(angle))
        return total / RINGS


def _correlation(a: list[float], b: list[float]) -> float:
    x, y = np.array(a) - np.mean(a), np.array(b) - np.mean(b)
    return float(x @ y / math.sqrt(max(float(x @ x) * float(y @ y), 1e-12)))


class MatchTemplate:
    """cv2.matchTemplate over 3 scales about the known one and 18 rotations; a picture of the symbol 24 pixels high, or
    as high as it is where that is less.
    """

    def find(self, frame: Frame, scale_px: float) -> list[Seen]:
        factor = min(1.0, 24.0 / scale_px)
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        if factor < 1.0:
            grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        best = Seen(0.0, 0.0, 0.0, 0.0)
        whole = drawn_h(120)
        for scale in TEMPLATE_SCALES:
            half = max(math.ceil(0.66 * scale_px * factor * scale), 3)
            if 2 * half + 1 > min(grey.shape):
                continue
            for turn in range(ROTATIONS):
                degrees = 180.0 * turn / ROTATIONS
                matrix = cv2.getRotationMatrix2D((119.5, 119.5), -degrees, scale_px * factor * scale / 120.0)
                shift = np.array([[0.0, 0.0, half - 119.5], [0.0, 0.0, half - 119.5]])
                symbol = cv2.warpAffine(
                    cv2.GaussianBlur(whole, (0, 0), 5.0), np.asarray(matrix) + shift, (2 * half + 1, 2 * half + 1)
                )
                _, score, _, (x, y) = cv2.minMaxLoc(cv2.matchTemplate(grey, symbol, cv2.TM_CCOEFF_NORMED))
                if score > best.score:
                    u, v = (x + half + 0.5) / factor - 0.5, (y + half + 0.5) / factor - 0.5
                    best = Seen(u, v, math.radians(degrees), float(score))
        return [best] if best.score >= MATCH else []


class Tags:
    """OpenCV's AprilTag 36h11, corners refined between pixels."""

    def __init__(self) -> None:
        options = cv2.aruco.DetectorParameters()
        options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        marks = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        self._detector = cv2.aruco.ArucoDetector(marks, options)

    def find(self, frame: Frame, scale_px: float) -> list[Seen]:
        corners, ids, _ = self._detector.detectMarkers(frame)
        found = []
        for square, number in zip(corners, np.ravel(ids) if len(corners) else (), strict=True):
            a, b, c, d = np.asarray(square, dtype=float).reshape(4, 2)
            # Where the diagonals cross is the middle under any perspective.
            t = np.linalg.solve(np.column_stack([c - a, b - d]), b - a)[0]
            middle = a + t * (c - a)
            up = (a + b - c - d) / 2.0
            heading = math.atan2(up[0], -up[1]) % math.pi
            found.append(Seen(float(middle[0]), float(middle[1]), heading, 1.0 if number == 5 else 0.5))
        return sorted(found, key=lambda s: -s.score)
