"""What a pixel sees: the pinhole with OpenCV's distortion, and how the camera is mounted.

Source: OpenCV, "Camera Calibration and 3D Reconstruction" (the model); Hartley and Zisserman, "Multiple View Geometry",
2nd ed., section 6.1. Pixel (0, 0) is the *centre* of the upper left one. Camera axes: x right and y down in the
picture, z along the optical axis; a vehicle's: forward, right, down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zmav.errors import BadInput
from zmav.vision.opencv import opencv
from zmav.wire import CameraInfo

Array = NDArray[np.float64]
LOOKING_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""columns: the axes of a camera that looks straight down, its upper edge to the nose, in the vehicle's axes"""
STEPS, EPSILON = 50, 1e-10
"""of undoing the distortion: at most so many, until so little changes (normalised)"""


@dataclass(frozen=True)
class Optics:
    """A camera's lens and mount, for pictures of ``width`` by ``height`` pixels."""

    width: int
    height: int
    matrix: Array
    """(3, 3): K"""
    distortion: Array
    """(5,): k1, k2, p1, p2, k3"""
    mount: Array
    """(3, 3) rotation, camera to vehicle"""
    offset: Array
    """(3,) m forward, right, down of the vehicle's reference point"""
    gimbal: bool = False
    """levelled: of the vehicle's attitude only the heading counts"""

    @classmethod
    def of(cls, info: CameraInfo) -> Optics:
        """From what a camera says of itself; raises :class:`BadInput` for numbers that are no camera's."""
        (fx, fy), (cx, cy) = info.focal, info.center
        values = (fx, fy, cx, cy, *info.distortion, *info.mount, *info.offset)
        if not all(map(math.isfinite, values)) or min(fx, fy) <= 0.0 or min(info.width, info.height) <= 0:
            text = f"camera {info.camera}: focal length {info.focal}, centre {info.center}, {info.width}x{info.height}"
            raise BadInput(text, field="camera", value=info.camera, expected="finite numbers, focal length above 0")
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        mount: Array = euler_matrix(*info.mount) @ LOOKING_DOWN
        return cls(
            info.width, info.height, matrix, np.array(info.distortion), mount, np.array(info.offset), info.gimbal
        )

    def scaled(self, width: int, height: int) -> Optics:
        """The same for a picture that was resized, as cameras do on a narrow link; centres map by (u + 0.5) k - 0.5."""
        if (width, height) == (self.width, self.height):
            return self
        kx, ky = width / self.width, height / self.height
        scale = np.array([[kx, 0.0, 0.5 * kx - 0.5], [0.0, ky, 0.5 * ky - 0.5], [0.0, 0.0, 1.0]])
        return Optics(width, height, scale @ self.matrix, self.distortion, self.mount, self.offset, self.gimbal)

    def rays(self, pixels: Array) -> Array:
        """(N, 3) unit rays in camera axes of (N, 2) pixels; needs OpenCV where the lens distorts."""
        points = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        if self.distortion.any() and len(points):
            cv2 = opencv()
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, STEPS, EPSILON)
            undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 5 has made them one
            flat = undistort(points[:, None], self.matrix, self.distortion, R=None, P=None, criteria=criteria)[:, 0]
        else:
            flat = (points - self.matrix[:2, 2]) / self.matrix.diagonal()[:2]
        rays = np.column_stack([flat, np.ones(len(points))])
        unit: Array = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return unit

    def pixels(self, rays: Array) -> Array:
        """(N, 2) pixels of (N, 3) rays in camera axes, which point ahead."""
        x, y = (rays[:, :2] / rays[:, 2:]).T
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        bent = np.column_stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
            ]
        )
        found: Array = bent * self.matrix.diagonal()[:2] + self.matrix[:2, 2]
        return found

    def to_vehicle(self, rays: Array) -> Array:
        """(N, 3) in the vehicle's axes of (N, 3) in the camera's."""
        turned: Array = np.asarray(rays) @ self.mount.T
        return turned


def euler_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) rotation from turned to unturned axes of roll, pitch and yaw in radians (Z-Y-X)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
