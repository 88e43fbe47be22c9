"""What vehicles look like: simple meshes built here, in body axes (forward, right, down), about two metres across.

They are larger than most real vehicles, so that one is still seen across a field; ``zmav view --size`` scales them.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zmav.wire import Vector

Points = npt.NDArray[np.float32]
BRIGHT, DIM, DARK = (255, 255, 255), (170, 170, 175), (60, 62, 68)
Tint = tuple[int, int, int]
"""multiplied by the vehicle's own colour"""


class Model(NamedTuple):
    """Triangles, three corners each, with the normal and the tint of each corner."""

    corners: Points
    normals: Points
    tints: npt.NDArray[np.uint8]


class _Builder:
    def __init__(self) -> None:
        self._triangles: list[tuple[Vector, Vector, Vector]] = []
        self._tints: list[Tint] = []

    def triangle(self, a: Vector, b: Vector, c: Vector, tint: Tint) -> None:
        self._triangles.append((a, b, c))
        self._tints.append(tint)

    def quad(self, a: Vector, b: Vector, c: Vector, d: Vector, tint: Tint) -> None:
        self.triangle(a, b, c, tint)
        self.triangle(a, c, d, tint)

    def box(self, center: Vector, size: Vector, tint: Tint, yaw: float = 0.0) -> None:
        """``yaw``: radians about down."""
        cos, sin = math.cos(yaw), math.sin(yaw)

        def corner(i: int, j: int, k: int) -> Vector:
            x, y, z = i * size[0] / 2, j * size[1] / 2, k * size[2] / 2
            return center[0] + cos * x - sin * y, center[1] + sin * x + cos * y, center[2] + z

        for i in (-1, 1):
            self.quad(corner(i, -1, -1), corner(i, 1, -1), corner(i, 1, 1), corner(i, -1, 1), tint)
            self.quad(corner(-1, i, -1), corner(1, i, -1), corner(1, i, 1), corner(-1, i, 1), tint)
            self.quad(corner(-1, -1, i), corner(1, -1, i), corner(1, 1, i), corner(-1, 1, i), tint)

    def disc(self, center: Vector, radius: float, tint: Tint, sides: int = 14) -> None:
        """A thin disc about down."""
        turns = [2 * math.pi * step / sides for step in range(sides + 1)]
        rim = [(center[0] + radius * math.cos(t), center[1] + radius * math.sin(t), center[2]) for t in turns]
        for a, b in itertools.pairwise(rim):
            self.triangle(center, a, b, tint)

    def model(self, size: float) -> Model:
        corners = np.asarray(self._triangles, dtype=np.float32) * np.float32(size)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # Lit from above whichever way a triangle is wound: its upper side is the one that is seen.
        normals *= np.where(normals[:, 2:] > 0, -1.0, 1.0)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return Model(
            corners.reshape(-1, 3),
            np.repeat(normals, 3, axis=0).astype(np.float32),
            np.repeat(np.asarray(self._tints, dtype=np.uint8), 3, axis=0),
        )


def _copter(b: _Builder) -> None:
    b.box((0.0, 0.0, 0.0), (0.5, 0.34, 0.18), BRIGHT)
    b.box((0.27, 0.0, 0.0), (0.14, 0.2, 0.1), DARK)
    for turn in (1, 3, 5, 7):
        angle = turn * math.pi / 4
        x, y = 0.72 * math.cos(angle), 0.72 * math.sin(angle)
        b.box((x / 2, y / 2, 0.0), (0.72, 0.07, 0.06), DIM, angle)
        b.disc((x, y, -0.1), 0.38, BRIGHT if x > 0 else DIM)
        b.box((x, y, 0.0), (0.1, 0.1, 0.16), DARK)


def _plane(b: _Builder) -> None:
    b.box((-0.1, 0.0, 0.0), (1.5, 0.18, 0.18), BRIGHT)
    b.box((0.75, 0.0, 0.0), (0.2, 0.12, 0.12), DARK)
    b.box((0.2, 0.0, -0.06), (0.34, 2.4, 0.05), BRIGHT)
    b.box((-0.78, 0.0, -0.02), (0.24, 0.8, 0.04), DIM)
    b.quad((-0.9, 0.0, 0.0), (-0.62, 0.0, 0.0), (-0.82, 0.0, -0.36), (-0.96, 0.0, -0.36), DIM)


def _rover(b: _Builder) -> None:
    b.box((0.0, 0.0, -0.38), (1.4, 0.8, 0.26), BRIGHT)
    b.box((-0.2, 0.0, -0.6), (0.7, 0.6, 0.2), DIM)
    b.box((0.3, 0.0, -0.58), (0.1, 0.12, 0.28), DARK)
    for x in (-0.46, 0.46):
        for y in (-0.46, 0.46):
            b.box((x, y, -0.24), (0.4, 0.12, 0.4), DARK)


def _other(b: _Builder) -> None:
    b.box((0.0, 0.0, 0.0), (1.2, 0.4, 0.3), BRIGHT)
    b.box((0.7, 0.0, 0.0), (0.2, 0.2, 0.15), DARK)


_KINDS = {"copter": _copter, "heli": _copter, "plane": _plane, "vtol": _plane, "rover": _rover, "boat": _rover}


def model(kind: str | None, size: float = 1.0) -> Model:
    """The model of a kind of vehicle (:attr:`zmav.wire.VehicleState.kind`), enlarged ``size`` times."""
    builder = _Builder()
    _KINDS.get(kind or "", _other)(builder)
    return builder.model(size * (1.3 if kind in ("plane", "vtol") else 1.0))
