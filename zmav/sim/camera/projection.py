"""From the world to the picture: the camera's axes, its matrix, and the plane-to-picture homographies.

Source: Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., sections 6.1 (camera matrix) and
8.1 (planes); the distortion is OpenCV's ("Camera Calibration and 3D Reconstruction"), after Brown 1966.

Camera axes are OpenCV's: x right and y down in the picture, z along the optical axis. The world is NED, metres.
"""

from __future__ import annotations

import math

import numpy as np

from zmav.sim.arrays import Array
from zmav.sim.camera.spec import CameraSpec

# Columns: the axes of a camera that looks straight down, in the axes of its mount (forward, right, down).
LOOKING_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
INVERSION_STEPS = 60


def camera_matrix(spec: CameraSpec) -> Array:
    """(3, 3): K."""
    u, v = spec.center
    return np.array([[spec.focal, 0.0, u], [0.0, spec.focal, v], [0.0, 0.0, 1.0]])


def euler_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) rotation body to world of roll, pitch and yaw in radians (Z-Y-X)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quat_matrix(q: Array) -> Array:
    """(3, 3) rotation body to world of one quaternion (w, x, y, z)."""
    w, x, y, z = (float(c) for c in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def mount_matrix(spec: CameraSpec) -> Array:
    """(3, 3) rotation camera to body."""
    roll, pitch, yaw = (math.radians(a) for a in spec.mount_deg)
    rotation: Array = euler_matrix(roll, pitch, yaw) @ LOOKING_DOWN
    return rotation


def camera_rotation(spec: CameraSpec, q: Array) -> Array:
    """(3, 3) rotation camera to world for a vehicle of attitude ``q`` (w, x, y, z)."""
    body = quat_matrix(q)
    if spec.gimbal:
        body = euler_matrix(0.0, 0.0, math.atan2(body[1, 0], body[0, 0]))
    rotation: Array = body @ mount_matrix(spec)
    return rotation


class View:
    """A pinhole at ``center`` (3,) NED with ``rotation`` (3, 3) camera to world and camera matrix ``k`` (3, 3)."""

    def __init__(self, k: Array, rotation: Array, center: Array, size: tuple[int, int]) -> None:
        self.k = k
        self.rotation = rotation
        self.center = center
        self.size = size
        """width and height, pixels"""
        self.to_camera: Array = rotation.T
        self.matrix: Array = k @ self.to_camera
        """K R, (3, 3)"""

    def plane(self, origin: Array, along: Array, across: Array) -> Array:
        """(3, 3): (a, b, 1) -> (u w, v w, w) of the point ``origin + a along + b across``; w is its distance along the
        optical axis in metres, and not above 0 behind the camera.
        """
        return self.matrix @ np.column_stack([along, across, origin - self.center])

    def project(self, points: Array) -> Array:
        """(3, N): (u w, v w, w) of (3, N) points NED; w as in :meth:`plane`."""
        result: Array = self.matrix @ (points - self.center[:, None])
        return result

    def ray_row(self, direction: Array) -> Array:
        """(3,): row that gives, of a pixel (u, v, 1), the part along ``direction`` (NED) of its ray with length 1 along
        the optical axis.
        """
        result: Array = direction @ self.rotation @ np.linalg.inv(self.k)
        return result


def distort(spec: CameraSpec, x: Array, y: Array) -> tuple[Array, Array]:
    """Where the lens puts the normalised coordinates ``x`` and ``y`` (ratios to the optical axis), as such."""
    k1, k2, p1, p2, k3 = spec.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    dy = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return dx, dy


def undistort(spec: CameraSpec, x: Array, y: Array) -> tuple[Array, Array, float]:
    """The inverse of :func:`distort` by fixed-point iteration, and the greatest error left (normalised)."""
    k1, k2, p1, p2, k3 = spec.distortion
    ux, uy = x.copy(), y.copy()
    with np.errstate(all="ignore"):
        for _ in range(INVERSION_STEPS):
            r2 = ux * ux + uy * uy
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            ux, uy = (
                (x - 2.0 * p1 * ux * uy - p2 * (r2 + 2.0 * ux * ux)) / radial,
                (y - p1 * (r2 + 2.0 * uy * uy) - 2.0 * p2 * ux * uy) / radial,
            )
        bx, by = distort(spec, ux, uy)
        error = np.hypot(bx - x, by - y)
    worst = float(error.max()) if np.isfinite(error).all() else math.inf
    return ux, uy, worst
