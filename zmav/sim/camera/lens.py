"""The lens: from the pinhole's picture to the distorted one. The distortion is OpenCV's ("Camera Calibration and 3D
Reconstruction"), after Brown 1966.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadConfig
from zmav.sim.arrays import Array
from zmav.sim.camera.projection import camera_matrix
from zmav.sim.camera.spec import CameraSpec

Image = NDArray[np.uint8]

LARGEST = 4  # times the picture that a distorted one may be made from
INVERTIBLE_PX = 1e-3  # greatest error of an undistorted pixel
STEPS, ENOUGH = 60, 1e-12  # of undoing the distortion: at most so many, until so little changes
JPEG_QUALITY = 85


class Lens:
    """Of one camera. What is rendered is ``size`` large with the camera matrix ``k``, without distortion.

    :class:`BadConfig` where the distortion folds the picture onto itself.
    """

    def __init__(self, spec: CameraSpec) -> None:
        self.k: Array = camera_matrix(spec)
        self.size = (spec.width, spec.height)
        self._maps: tuple[Image, Image] | None = None
        if any(spec.distortion):
            self._bend(spec)

    def develop(self, image: Image) -> Image:
        """From what falls on the lens to what the sensor gives, (height, width, 3) BGR."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)

    def _bend(self, spec: CameraSpec) -> None:
        """Where each pixel of the distorted picture lies in the pinhole's, which must hold them all."""
        k, distortion = self.k, np.array(spec.distortion)
        pixels = np.stack(np.meshgrid(np.arange(spec.width, dtype=float), np.arange(spec.height, dtype=float)), -1)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, STEPS, ENOUGH)
        undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 5 has made them one
        flat = np.asarray(undistort(pixels.reshape(-1, 1, 2), k, distortion, R=None, P=None, criteria=criteria))
        rays = np.dstack([flat, np.ones((len(flat), 1))])
        back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), k, distortion)
        error = np.abs(back.reshape(pixels.shape) - pixels).max()
        if not (error < INVERTIBLE_PX and _grows(spec, flat)):
            raise _wrong(spec, "folds the picture onto itself", "coefficients that can be inverted")
        u, v = (flat[:, 0] * k.diagonal()[:2] + k[:2, 2]).T.reshape(2, spec.height, spec.width)
        left, top = math.floor(u.min()) - 1, math.floor(v.min()) - 1
        self.size = (math.ceil(u.max()) + 2 - left, math.ceil(v.max()) + 2 - top)
        if self.size[0] > LARGEST * spec.width or self.size[1] > LARGEST * spec.height:
            raise _wrong(spec, f"needs {self.size[0]}x{self.size[1]} pixels", f"at most {LARGEST} times the picture's")
        self.k = k - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
        maps = cv2.convertMaps((u - left).astype(np.float32), (v - top).astype(np.float32), cv2.CV_16SC2)
        self._maps = (maps[0], maps[1])  # of 16 bits


def encode(image: Image) -> bytes:
    """As JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()


def _wrong(spec: CameraSpec, why: str, expected: str) -> BadConfig:
    text = f"distortion {spec.distortion} {why}; expected {expected}"
    return BadConfig(text, field="distortion", value=spec.distortion, expected=expected)


def _grows(spec: CameraSpec, flat: Array) -> bool:
    """Whether the lens keeps the order of points along every ray from the axis, out to the picture's corners."""
    far = np.sqrt((flat * flat).sum(-1)).max() * np.linspace(0.0, 1.0, 200)
    k1, k2, _, _, k3 = spec.distortion
    r2 = far * far
    return bool((np.diff(far * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))) > 0.0).all())
