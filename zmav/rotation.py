"""Quaternions (w, x, y, z, from body to NED) and Euler angles (roll, pitch, yaw, turned in the order Z-Y-X), in plain
numbers: of so few, arrays would take longer to make than the sums do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Quaternion = tuple[float, float, float, float]
Angle = TypeVar("Angle", float, "NDArray[np.float64]")


def wrap(angle: Angle) -> Angle:
    """Radians brought into [-π, π): a number, or an array of them."""
    return (angle + math.pi) % math.tau - math.pi


def product(a: Iterable[float], b: Iterable[float]) -> Quaternion:
    """Hamilton's: the rotation ``b`` first, then ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def from_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """The rotation that yaws, pitches and rolls, in this order (radians)."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler(q: Iterable[float]) -> tuple[float, float, float]:
    """Roll, pitch and yaw, radians: the inverse of :func:`from_euler`."""
    w, x, y, z = q
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, pitch, heading((w, x, y, z))


def heading(q: Iterable[float]) -> float:
    """Yaw, radians clockwise from north."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def to_body(q: Iterable[float], vector: Iterable[float]) -> tuple[float, float, float]:
    """A vector of the world in body axes: by the transpose of the rotation matrix."""
    (w, x, y, z), (north, east, down) = q, vector
    return (
        (1 - 2 * (y * y + z * z)) * north + 2 * (x * y + w * z) * east + 2 * (x * z - w * y) * down,
        2 * (x * y - w * z) * north + (1 - 2 * (x * x + z * z)) * east + 2 * (y * z + w * x) * down,
        2 * (x * z + w * y) * north + 2 * (y * z - w * x) * east + (1 - 2 * (x * x + y * y)) * down,
    )
