"""The numpy array types of the simulator, and the vector algebra that its vectorised parts share.

Arrays hold one *column* per vehicle: shape ``(N,)`` for a scalar, ``(3, N)`` for a vector, ``(4, N)`` for a quaternion
(w, x, y, z; body to world). A row is then contiguous, and formulas read component by component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
"""of the three axes, for vector products"""
_FACTORS = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGNS = np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1]], np.float64)[:, :, None]
"""of a Hamilton product: row by row, what each component of the first factor multiplies of the second"""
_RATE_FACTORS, _RATE_SIGNS = _FACTORS[1:], 0.5 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [-1, 1, -1, 1]])[:, :, None]
"""of an attitude's derivative: row by row, what each body rate multiplies of the attitude"""
_MATRIX: tuple[Indices, Indices, Array, Array] = (
    np.array([[2, 1, 1, 1, 1, 2, 1, 2, 1], [3, 0, 0, 0, 3, 0, 0, 0, 2]]),
    np.array([[2, 2, 3, 2, 1, 3, 3, 3, 1], [3, 3, 2, 3, 3, 1, 2, 1, 2]]),
    2.0 * np.array([[-1, 1, 1, 1, -1, 1, 1, 1, -1], [-1, -1, 1, 1, -1, -1, -1, 1, -1]])[:, :, None],
    np.eye(3).reshape(9, 1),
)
"""of a rotation matrix, row by row: which two components of the quaternion are multiplied in each of two terms, by what
factor beside, and what is added"""
_DOWN = _MATRIX[0][:, 2::3].copy(), _MATRIX[1][:, 2::3].copy(), _MATRIX[2][:, 2::3].copy(), _MATRIX[3][2::3].copy()
"""the same of its last column"""


def limit_length(vector: Array, limit: Array | float) -> Array:
    """``vector`` (k, N), shortened where it is longer than ``limit`` (N,)."""
    length = np.sqrt(dot(vector, vector))
    shorter: Array = vector * (limit / np.maximum(length, np.maximum(limit, 1e-9)))
    return shorter


def clamp(value: Array, low: Array | float, high: Array | float) -> Array:
    """As ``np.clip``, at a third of its cost on short arrays."""
    return np.minimum(np.maximum(value, low), high)


def any_of(flags: Flags) -> bool:
    """As ``flags.any()`` of flags (N,), at a tenth of its cost on short arrays."""
    return True in flags.tolist()


def all_of(flags: Flags) -> bool:
    """As ``flags.all()`` of flags (N,), at a tenth of its cost on short arrays."""
    return False not in flags.tolist()


def quat_multiply(a: Array, b: Array) -> Array:
    """Hamilton product of (4, N) quaternions: the rotation ``b`` first, then ``a``."""
    terms = b.take(_FACTORS, axis=0)  # a third of the cost, on short arrays, of the sixteen products one by one
    terms *= _SIGNS
    terms *= a[:, None]
    product: Array = np.add.reduce(terms)
    return product


def quat_rate(q: Array, rate: Array) -> Array:
    """Time derivative of attitude ``q`` (4, N) at body rates ``rate`` (3, N) rad/s: ``q * (0, rate) / 2``."""
    terms = q.take(_RATE_FACTORS, axis=0)
    terms *= _RATE_SIGNS
    terms *= rate[:, None]
    derivative: Array = np.add.reduce(terms)
    return derivative


def dot(a: Array, b: Array) -> Array:
    """Scalar products of the columns of two (k, N) arrays, (N,)."""
    product: Array = np.add.reduce(a * b)
    return product


def cross(a: Array, b: Array) -> Array:
    """Vector products along the first axis (3, ...); a quarter of ``np.cross``'s cost on short arrays."""
    product: Array = a.take(NEXT, axis=0) * b.take(LAST, axis=0) - a.take(LAST, axis=0) * b.take(NEXT, axis=0)
    return product


def quat_error(target: Array, actual: Array) -> Array:
    """Rotation from ``actual`` to ``target`` in body axes: ``conj(actual) * target``, (4, N)."""
    conj = actual.copy()
    conj[1:] = -conj[1:]
    return quat_multiply(conj, target)


def body_z(q: Array) -> Array:
    """The body's down axis in world NED, (3, N)."""
    return _rotation_rows(q, *_DOWN)


def rotation_matrix(q: Array) -> Array:
    """(3, 3, N) body-to-world rotation matrices."""
    return _rotation_rows(q, *_MATRIX).reshape(3, 3, -1)


def _rotation_rows(q: Array, first: Indices, second: Indices, factors: Array, plus: Array) -> Array:
    """Some entries of the rotation matrix: few operations on whole blocks, as each has its price on short arrays."""
    terms = q.take(first, axis=0)
    terms *= q.take(second, axis=0)
    terms *= factors
    rows: Array = terms[0] + terms[1]
    rows += plus
    return rows


def euler_from_matrix(rot: Array) -> Array:
    """(3, N) roll, pitch, yaw in radians (Z-Y-X, aerospace) of :func:`rotation_matrix`'s (3, 3, N)."""
    out = np.empty((3, rot.shape[2]))
    np.arctan2(rot[2, 1], rot[2, 2], out=out[0])
    np.arcsin(clamp(0.0 - rot[2, 0], -1.0, 1.0), out=out[1])
    np.arctan2(rot[1, 0], rot[0, 0], out=out[2])
    return out


def yaw_of(q: Array) -> Array:
    """Headings (N,) of attitudes (4, N), radians."""
    w, x, y, z = q
    result: Array = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return result


def quat_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """(4, N) quaternions of roll, pitch, yaw in radians (Z-Y-X, aerospace)."""
    half = np.array([roll, pitch, yaw]) * 0.5
    cr, cp, cy = np.cos(half)
    sr, sp, sy = np.sin(half)
    cc, ss, sc, cs = cp * cy, sp * sy, sp * cy, cp * sy
    return np.array([cr * cc + sr * ss, sr * cc - cr * ss, cr * sc + sr * cs, cr * cs - sr * sc])


def thrust_frame(down: Array, yaw: Array) -> Array:
    """(4, N) attitudes whose body-down axis is ``down`` (3, N unit vectors, NED) and whose nose points to ``yaw``.

    Source: Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011, section IV,
    written for a north-east-down frame. ``down`` must not be level with the nose (leans below 90 degrees).
    """
    cy, sy = np.cos(yaw), np.sin(yaw)
    # In the frame turned by yaw the nose is level: roll and pitch follow from the down axis seen there.
    forward = down[0] * cy + down[1] * sy
    right = -down[0] * sy + down[1] * cy
    roll = np.arcsin(clamp(-right, -1.0, 1.0))
    pitch = np.arctan2(forward, down[2])
    return quat_from_euler(roll, pitch, yaw)
