"""From the world to the picture: the camera's axes, its matrix, and the plane-to-picture homographies.

Source: Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed., sections 6.1 (camera matrix) and
8.1 (planes). Camera axes are OpenCV's: x right and y down in the picture, z along the optical axis. The world is NED,
metres.
"""

from __future__ import annotations

import math

import numpy as np

from zmav import rotation
from zmav.sim.arrays import Array, rotation_matrix
from zmav.sim.camera.spec import CameraSpec

# Columns: the axes of a camera that looks straight down, in the axes of its mount (forward, right, down).
LOOKING_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def camera_matrix(spec: CameraSpec) -> Array:
    """(3, 3): K."""
    u, v = (spec.width - 1) / 2.0, (spec.height - 1) / 2.0
    return np.array([[spec.focal_px, 0.0, u], [0.0, spec.focal_px, v], [0.0, 0.0, 1.0]])


def quat_matrix(q: Array) -> Array:
    """(3, 3) rotation body to world of one quaternion (w, x, y, z)."""
    matrix: Array = rotation_matrix(np.asarray(q)[:, None])[:, :, 0]
    return matrix


def mount_matrix(spec: CameraSpec) -> Array:
    """(3, 3) rotation camera to body."""
    mount: Array = quat_matrix(np.array(rotation.from_euler(*map(math.radians, spec.mount_deg)))) @ LOOKING_DOWN
    return mount


def camera_rotation(spec: CameraSpec, q: Array) -> Array:
    """(3, 3) rotation camera to world for a vehicle of attitude ``q`` (w, x, y, z)."""
    if spec.gimbal:
        q = np.array(rotation.from_euler(0.0, 0.0, rotation.heading(q.tolist())))
    turned: Array = quat_matrix(q) @ mount_matrix(spec)
    return turned


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
