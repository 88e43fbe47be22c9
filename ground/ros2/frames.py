"""Frames by REP-103 and REP-105: ROS has east, north, up and forward, left, up; MAVLink north, east, down and forward,
right, down. Quaternions are (x, y, z, w), as in ROS; angles are radians.
"""

from __future__ import annotations

import math

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
    return quaternion(roll, -pitch, heading(yaw))


def quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Of rotations about z, then y, then x."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def yaw_of(q: Quaternion) -> float:
    """The rotation about z of a quaternion."""
    x, y, z, w = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def in_body(vector: Vector, q: Quaternion) -> Vector:
    """A vector of the world, as the body that is turned by ``q`` has it."""
    x, y, z, w = -q[0], -q[1], -q[2], q[3]
    vx, vy, vz = vector
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)
