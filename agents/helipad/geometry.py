"""Between pixels and a level plane below the camera that is measured in heights of the symbol.

The camera's axes are OpenCV's: x right and y down in the picture, z along the optical axis; with no roll or pitch it
looks straight down with the upper edge of the picture ahead. The plane's x and y are a level camera's.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.vision.optics import LOOKING_DOWN, euler_matrix

Array = NDArray[np.float64]

_NEAR = 0.01
"""heights of a symbol; the step of the finite differences"""


def tilt(roll: float, pitch: float) -> Array:
    """(3, 3) rotation from the camera's axes to a level camera's of the same heading; radians."""
    result: Array = LOOKING_DOWN.T @ euler_matrix(roll, pitch, 0.0) @ LOOKING_DOWN
    return result


class View:
    """The plane ``distance`` symbol heights below a camera of matrix ``k`` (3, 3), rolled and pitched; radians."""

    def __init__(
        self, k: Array, distortion: Array | None, distance: float, roll: float = 0.0, pitch: float = 0.0
    ) -> None:
        self.k = k
        self.distortion = distortion
        self.distance = distance
        self.matrix: Array = np.asarray(k @ tilt(roll, pitch).T @ np.diag([1.0, 1.0, distance]), dtype=float)
        self._back: Array = np.asarray(np.linalg.inv(self.matrix), dtype=float)

    @property
    def scale(self) -> float:
        """Pixels of a symbol's height straight below."""
        return float(math.sqrt(self.k[0, 0] * self.k[1, 1])) / self.distance

    def flat(self, pixels: Array) -> Array:
        """:meth:`to_plane` of a lens without distortion."""
        return _apply(self._back, pixels)

    def to_plane(self, pixels: Array) -> Array:
        """(N, 2) pixels -> (N, 2) on the plane."""
        if self.distortion is not None and len(pixels):
            straight = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.k, self.distortion, None, None, self.k)
            pixels = np.asarray(straight, dtype=float).reshape(-1, 2)
        return _apply(self._back, pixels)

    def to_pixels(self, points: Array) -> Array:
        """(N, 2) on the plane -> (N, 2) pixels."""
        pixels = _apply(self.matrix, points)
        if self.distortion is None or not len(pixels):
            return pixels
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.k).T
        bent, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.k, self.distortion)
        return np.asarray(bent, dtype=float).reshape(-1, 2)

    def in_front(self, pixels: Array) -> NDArray[np.bool_]:
        """(N,): which of (N, 2) pixels see the plane at all."""
        result: NDArray[np.bool_] = pixels @ self._back[2, :2] + self._back[2, 2] > 0.05 / self.distance
        return result

    def affine(self, pixels: Array) -> Array:
        """(N, 2, 2): how pixels move with the plane's x and y about (N, 2) ``pixels``."""
        middle = self.to_plane(pixels)
        sides = [self.to_pixels(middle + step) for step in ((_NEAR, 0.0), (-_NEAR, 0.0), (0.0, _NEAR), (0.0, -_NEAR))]
        result: Array = np.stack([sides[0] - sides[1], sides[2] - sides[3]], axis=-1) / (2.0 * _NEAR)
        return result


def _apply(matrix: Array, points: Array) -> Array:
    projected = points @ matrix[:, :2].T + matrix[:, 2]
    result: Array = projected[:, :2] / projected[:, 2:]
    return result
