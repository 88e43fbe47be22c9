"""Puts one picture together: the ground, what is painted on it, vehicles and roofs, the farther first."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array
from zmav.sim.camera.figures import Box, Figure, pad_sprite
from zmav.sim.camera.ground import Backdrop, GroundTexture
from zmav.sim.camera.projection import View, quat_matrix
from zmav.sim.camera.scene import Roof
from zmav.sim.camera.sprites import draw, fill

Image = NDArray[np.uint8]

LOWEST_M = 0.02  # a lens is never nearer to the ground
LIGHT = np.array([-0.5, 0.29, -0.82])  # where it comes from, NED
AMBIENT = 0.62  # of the light on a face turned away from it
ROOF = (150.0, 156.0, 158.0)
# Corners of a box (forward, right, up, each -1 or 1) and its faces: outward axis, sign, corners in order.
CORNERS = np.array([[f, r, h] for f in (-1.0, 1.0) for r in (-1.0, 1.0) for h in (-1.0, 1.0)]).T
FACES = (
    (0, -1.0, [0, 1, 3, 2]),
    (0, 1.0, [4, 5, 7, 6]),
    (1, -1.0, [0, 1, 5, 4]),
    (1, 1.0, [2, 3, 7, 6]),
    (2, -1.0, [0, 2, 6, 4]),
    (2, 1.0, [1, 3, 7, 5]),
)


class Renderer:
    """Pictures of one scene for one camera. ``figures``: what each vehicle of the world looks like, in order."""

    def __init__(self, ground: GroundTexture, figures: Sequence[Figure]) -> None:
        self.figures = figures
        self.backdrop = Backdrop(ground)
        self._reach = np.array([figure.reach for figure in figures])
        self._pads = [
            (_placing(placed.position, placed.heading_deg), pad_sprite(placed.pad)) for placed in ground.scene.pads
        ]
        self._roofs = [_roof_corners(roof) for roof in ground.scene.roofs]

    def lifted(self, center: Array) -> Array:
        """``center`` (3,) NED, or the place right above it that is high enough to see the ground."""
        return np.minimum(center, (np.inf, np.inf, -LOWEST_M))

    def render(self, view: View, pos: Array, q: Array, me: int) -> Image:
        """(h, w, 3) BGR of what ``view`` sees of vehicles at ``pos`` (3, N) NED with attitudes ``q`` (4, N); vehicle
        ``me`` carries it and is not seen.
        """
        image: Image = np.empty((view.size[1], view.size[0], 3), dtype=np.uint8)
        plane = view.plane(np.zeros(3), *np.eye(3)[:2])
        self.backdrop.draw(image, view, plane)
        for placing, sprite in self._pads:
            draw(image, sprite, plane @ placing)
        # Sorted by how far above or below the camera they are.
        todo: list[tuple[float, Callable[[], None]]] = []
        for corners in self._roofs:
            todo.append((corners[2, 0], lambda corners=corners: fill(image, view.project(corners), ROOF)))  # type: ignore[misc]
        for i in self._near(view, pos):
            if i != me:
                place, turned = pos[:, i], quat_matrix(q[:, i])
                todo.append((place[2], lambda i=i, at=place, r=turned: self._draw_vehicle(image, view, i, at, r)))  # type: ignore[misc]
        for _, paint in sorted(todo, key=lambda each: -abs(each[0] - view.center[2])):
            paint()
        return image

    def _near(self, view: View, pos: Array) -> list[int]:
        """Vehicles that may be in the picture."""
        at = view.to_camera @ (pos - view.center[:, None])
        side = max(view.size) / float(view.k[0, 0])
        aside = np.maximum(np.abs(at[0]), np.abs(at[1]))
        close = (at[2] > -self._reach) & (aside < np.maximum(at[2], 0.0) * side + 2.0 * self._reach)
        return [int(i) for i in np.flatnonzero(close)]

    def _draw_vehicle(self, image: Image, view: View, i: int, pos: Array, rotation: Array) -> None:
        figure = self.figures[i]

        def away(box: Box) -> float:
            return float(np.linalg.norm(_place(box.center, pos, rotation) - view.center))

        for box in sorted(figure.boxes, key=away, reverse=True):
            _draw_box(image, view, box, pos, rotation)
        if figure.pad is not None:
            center = _place((0.0, 0.0, figure.deck_m), pos, rotation)
            if float(rotation[:, 2] @ (center - view.center)) > 0.0:  # from below it is not seen
                draw(image, figure.pad, view.plane(center, rotation[:, 0], rotation[:, 1]))


def _roof_corners(roof: Roof) -> Array:
    """(3, 4) NED."""
    a, b = roof.size[0] / 2.0, roof.size[1] / 2.0
    corners: Array = _placing(roof.center, roof.heading_deg) @ np.array(
        [[a, a, -a, -a], [-b, b, b, -b], [1.0, 1.0, 1.0, 1.0]]
    )
    corners[2] = -roof.height_m
    return corners


def _draw_box(image: Image, view: View, box: Box, pos: Array, rotation: Array) -> None:
    offsets = CORNERS * np.array(box.half)[:, None]
    offsets[2] *= -1.0
    corners = _place(box.center, pos, rotation)[:, None] + rotation @ offsets
    seen = view.project(corners)
    for axis, sign, order in FACES:
        normal = rotation[:, axis] * (sign if axis < 2 else -sign)  # the third axis is down, a box's is up
        if float(normal @ (corners[:, order].mean(1) - view.center)) >= 0.0:
            continue
        light = AMBIENT + (1.0 - AMBIENT) * max(0.0, float(normal @ LIGHT))
        fill(image, seen[:, order], tuple(light * c for c in box.color))


def _placing(position: tuple[float, float], heading_deg: float) -> Array:
    """(3, 3): (ahead, right, 1) of something that lies there -> (north, east, 1)."""
    c, s = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    return np.array([[c, -s, position[0]], [s, c, position[1]], [0.0, 0.0, 1.0]])


def _place(at: tuple[float, float, float], pos: Array, rotation: Array) -> Array:
    """(3,) NED of a place (forward, right, up) of a vehicle."""
    result: Array = pos + rotation @ (np.array(at) * (1.0, 1.0, -1.0))
    return result
