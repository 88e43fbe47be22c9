"""Pieces of a way by the distance along them: straight lines, and curves that are given by any parameter."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Shape = Callable[[Array], tuple[Array, Array, Array]]
"""(N,) of a parameter -> (N, 3) each: places, and their first and second derivatives by it"""
NODES = 400
"""of the table from distance to parameter"""
NUMERIC = 1.02
"""by which the sharpest change of a curve may be more than is found at the table's nodes"""


class StraightPiece:
    """From ``a`` straight to ``b``, (3,) each, which are apart. See :data:`Piece`."""

    bend = jolt = 0.0

    def __init__(self, a: Array, b: Array) -> None:
        self.a, self.b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        self.length = float(np.linalg.norm(self.b - self.a))
        self.direction = (self.b - self.a) / self.length

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        rows = np.ones((len(s), 1))
        return self.a + s[:, None] * self.direction, rows * self.direction, np.zeros((len(s), 3))


class Curve:
    """A regular curve from the parameter ``u0`` to ``u1``, read by its distance: a table, and cubics in it."""

    def __init__(self, shape: Shape, u0: float, u1: float) -> None:
        self._shape, self._u = shape, np.linspace(u0, u1, NODES)
        step = (u1 - u0) / (NODES - 1)
        at, weights = np.polynomial.legendre.leggauss(4)
        inside = self._u[:-1, None] + step * (0.5 + 0.5 * at)
        speeds = np.linalg.norm(shape(inside.ravel())[1], axis=1).reshape(inside.shape)
        self._s = np.concatenate(([0.0], np.cumsum(speeds @ weights * 0.5 * step)))
        self._slope = 1.0 / np.linalg.norm(shape(self._u)[1], axis=1)
        self.length = float(self._s[-1])
        _, _, bends = self._by(self._u)
        self.bend = float(np.linalg.norm(bends, axis=1).max())
        jolts = np.gradient(bends, self._s, axis=0, edge_order=2)
        self.jolt = NUMERIC * float(np.linalg.norm(jolts, axis=1).max())

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        return self._by(self._parameter(s))

    def _by(self, u: Array) -> tuple[Array, Array, Array]:
        place, first, second = self._shape(u)
        speed = np.linalg.norm(first, axis=1)[:, None]
        tangent = first / speed
        along = np.sum(tangent * second, axis=1)[:, None]
        return place, tangent, (second - along * tangent) / (speed * speed)

    def _parameter(self, s: Array) -> Array:
        s = np.clip(s, 0.0, self.length)
        k = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, NODES - 2)
        h = self._s[k + 1] - self._s[k]
        x = (s - self._s[k]) / h
        rest = 1.0 - x
        ends: Array = self._u[k] * rest * rest * (1.0 + 2.0 * x) + self._u[k + 1] * x * x * (3.0 - 2.0 * x)
        found: Array = ends + h * x * rest * (self._slope[k] * rest - self._slope[k + 1] * x)
        return found


Piece = StraightPiece | Curve
"""A smooth piece of a way, metres NED: its ``length``, its sharpest curvature ``bend`` (1/m; 0: it is straight), and
``jolt`` (1/m²), the greatest third derivative of the place by the distance. ``at(s)`` gives (N, 3) each at the
distances (N,): places, unit tangents and their derivatives by the distance.
"""


def lissajous(north: float, east: float, turns: float, phase: float, centre: Array, heading: float) -> Shape:
    """North ``north`` sin(u + ``phase``), east ``east`` sin(``turns`` u), turned clockwise by ``heading`` (rad), about
    ``centre`` (m NED); the parameter u in radians.
    """
    turn = turned(heading).T

    def shape(u: Array) -> tuple[Array, Array, Array]:
        v, w, none = u + phase, turns * u, np.zeros_like(u)
        place = np.column_stack((north * np.sin(v), east * np.sin(w), none))
        first = np.column_stack((north * np.cos(v), turns * east * np.cos(w), none))
        second = np.column_stack((-north * np.sin(v), -turns * turns * east * np.sin(w), none))
        return centre + place @ turn, first @ turn, second @ turn

    return shape


def turned(heading: float) -> Array:
    """(3, 3) that turns what looks north to look to ``heading`` (rad, clockwise)."""
    cos, sin = math.cos(heading), math.sin(heading)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
