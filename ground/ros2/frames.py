"""Frames by REP-103 and REP-105: ROS has east, north, up and forward, left, up; MAVLink north, east, down and forward,
right, down. Quaternions are (x, y, z, w), as in ROS; angles are radians.
"""

from __future__ import annotations

import math

from zmav import rotation
from zmav.wire import Vector

Quaternion = tuple[float, float, float, float]
"""x, y, z, w"""


def enu(ned: Vector) -> Vector:
    """East, north, up of north, east, down; and the other way, for it is its own inverse."""
    return ned[1], ned[0], -ned[2]


def flu(frd: Vector) -> Vector:
    """Forward, left, up of forward, right, down; its own inverse."""
    return frd[0], -frd[1], -frd[2]


def heading(yaw: float) -> float:
    """From east, counter-clockwise, of a yaw from north, clockwise: within ±π; its own inverse."""
    return math.remainder(math.pi / 2 - yaw, 2 * math.pi)


def orientation(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Of the body (forward, left, up) in east, north, up, by MAVLink's angles."""
    w, x, y, z = rotation.from_euler(roll, -pitch, heading(yaw))
    return x, y, z, w


def yaw_of(q: Quaternion) -> float:
    """The rotation about z of a quaternion."""
    return rotation.heading((q[3], *q[:3]))


def in_body(vector: Vector, q: Quaternion) -> Vector:
    """A vector of the world, as the body that is turned by ``q`` has it."""
    return rotation.to_body((q[3], *q[:3]), vector)


def in_world(vector: Vector, q: Quaternion) -> Vector:
    """A vector of the body that is turned by ``q``, as the world has it."""
    return rotation.to_body((q[3], -q[0], -q[1], -q[2]), vector)


def of_camera(mount: Vector) -> Quaternion:
    """Of a camera's axes (right, down, along its optical axis) in the body's, by roll, pitch and yaw from straight down
    (:class:`zmav.wire.CameraInfo`).
    """
    upright = rotation.product(rotation.from_euler(*mount), rotation.from_euler(0.0, 0.0, math.pi / 2))
    w, x, y, z = rotation.product((0.0, 1.0, 0.0, 0.0), upright)  # forward, left, up of forward, right, down
    return x, y, z, w
