"""Puts one picture together: the ground, what is painted on it, shadows, vehicles and roofs, the farther first."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array
from zmav.sim.camera.backdrop import Backdrop
from zmav.sim.camera.figures import Box, Figure, pad_sprite, roof_sprite
from zmav.sim.camera.ground import Ground
from zmav.sim.camera.poses import Poses
from zmav.sim.camera.projection import View, quat_matrix
from zmav.sim.camera.scene import Roof, Scene
from zmav.sim.camera.sprites import Sprite, draw, fill, shade
from zmav.sim.environment import Terrain

Image = NDArray[np.uint8]

LOWEST_M = 0.02  # a lens is never nearer to the ground
SUN_WIDTH = 0.0093  # rad, of the sun's disc: how fast the edge of a shadow widens
LOWEST_SUN = 0.05  # sine of its height above the ground's plane, below which there are no shadows
AMBIENT = 0.62  # of the light on a face turned away from the sun
# Corners of a box (forward, right, up, each -1 or 1) and its faces: outward axis, sign, corners in order.
CORNERS = np.array([[f, r, h] for f in (-1.0, 1.0) for r in (-1.0, 1.0) for h in (-1.0, 1.0)]).T
FACES = (
    (0, -1.0, (0, 1, 3, 2)),
    (0, 1.0, (4, 5, 7, 6)),
    (1, -1.0, (0, 1, 5, 4)),
    (1, 1.0, (2, 3, 7, 6)),
    (2, -1.0, (0, 2, 6, 4)),
    (2, 1.0, (1, 3, 7, 5)),
)


class Renderer:
    """Pictures of one scene for one camera. ``figures``: what each vehicle of the world looks like, in order."""

    def __init__(self, ground: Ground, terrain: Terrain, figures: Sequence[Figure]) -> None:
        self.scene: Scene = ground.scene
        self.figures = figures
        self.backdrop = Backdrop(ground, terrain)
        self._pads = [(placed, pad_sprite(placed.pad)) for placed in self.scene.pads]
        self._roofs = [(roof, roof_sprite(roof.ground, roof.size, ground.seed)) for roof in self.scene.roofs]
        light = self.scene.light
        azimuth, elevation = math.radians(light.sun_azimuth_deg), math.radians(light.sun_elevation_deg)
        level = math.cos(elevation)
        self._sun = np.array([level * math.cos(azimuth), level * math.sin(azimuth), -math.sin(elevation)])
        down = self.backdrop.down
        self._sun_height = -float(down @ self._sun)
        # Projects a point along the sun's rays on the ground's plane through the origin.
        self._cast: Array = np.eye(3) - np.outer(self._sun, down) / min(float(down @ self._sun), -1e-9)

    def lifted(self, center: Array) -> Array:
        """``center`` (3,) NED, or the place right above it that is high enough to see the ground."""
        missing = LOWEST_M - self.backdrop.height(center)
        result: Array = center if missing <= 0.0 else center - self.backdrop.down * missing
        return result

    def render(self, view: View, poses: Poses, me: int) -> Image:
        """(h, w, 3) BGR of what ``view`` sees; vehicle ``me`` carries it and casts a shadow only."""
        width, height = view.size
        image: Image = np.empty((height, width, 3), dtype=np.uint8)
        self.backdrop.draw(image, view)
        plane = self.backdrop.plane(view)
        for placed, sprite in self._pads:
            draw(image, sprite, plane @ _placing(placed.position, math.radians(placed.heading_deg)))
        share = self.scene.light.shadows
        if share > 0.0 and self._sun_height > LOWEST_SUN:
            self._draw_shadows(image, plane, poses, share)
        self._draw_objects(image, view, poses, me)
        return image

    # ---- shadows

    def _draw_shadows(self, image: Image, plane: Array, poses: Poses, share: float) -> None:
        for roof, _ in self._roofs:
            corners = self._roof_corners(roof)
            shade(image, plane @ self._shadow(corners), share, self._penumbra_px(plane, corners, roof.height_m))
        for i in self._near_shadows(plane, poses, image.shape[1]):
            self._draw_shadow(image, plane, poses, i, share)

    def _near_shadows(self, plane: Array, poses: Poses, width: int) -> list[int]:
        """Vehicles whose shadow may be in the picture."""
        at = plane @ self._shadow(poses.pos)
        reach = np.array([figure.reach for figure in self.figures]) / self._sun_height * 2.0
        # Metres on the ground are at most that many pixels at that distance, even slanted.
        pixels = reach * np.sqrt((plane[:2, :2] ** 2).sum()) / np.maximum(at[2], 1e-6) + width
        u, v = at[0] / np.maximum(at[2], 1e-6), at[1] / np.maximum(at[2], 1e-6)
        inside = (np.abs(u) < pixels + width) & (np.abs(v) < pixels + width)
        close = (at[2] > -reach) & ((np.abs(at[2]) < reach) | inside)
        return [int(i) for i in np.flatnonzero(close)]

    def _draw_shadow(self, image: Image, plane: Array, poses: Poses, i: int, share: float) -> None:
        figure, pos, rotation = self.figures[i], poses.pos[:, i], quat_matrix(poses.q[:, i])
        sprite = figure.spinning if poses.spinning[i] else figure.sprite
        if sprite is not None:
            center = pos - rotation[:, 2] * figure.height
            height = self.backdrop.height(center)
            if height > 0.0:
                flat = self._shadow(np.column_stack([rotation[:, 0], rotation[:, 1], center]), directions=2)
                draw(image, sprite, plane @ flat, shadow=share, blur_m=SUN_WIDTH * height / self._sun_height)
        if figure.boxes:
            solid = [_corners(box, pos, rotation) for box in figure.boxes]
            flat = self._shadow(np.hstack(solid))[:2].T
            hull = cv2.convexHull(flat.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            shade(image, plane @ np.vstack([hull.T, np.ones(len(hull))]), share)

    def _shadow(self, points: Array, directions: int = 0) -> Array:
        """(3, N): (north, east, 1) of the shadows of (3, N) points NED. The first ``directions`` columns are directions
        and get a 0 in place of the 1.
        """
        moved = points.copy()
        moved[:, directions:] -= self.backdrop.origin[:, None]
        result: Array = self._cast @ moved
        result[2] = 1.0
        result[2, :directions] = 0.0
        return result

    def _penumbra_px(self, plane: Array, corners: Array, height: float) -> float:
        at = plane @ self._shadow(corners)
        nearest = max(float(at[2].min()), 0.5)
        pixels = float(np.sqrt((plane[:2, 0] ** 2).sum())) / nearest
        return min(SUN_WIDTH * height / self._sun_height * pixels / 4.0, 8.0)

    # ---- things

    def _draw_objects(self, image: Image, view: View, poses: Poses, me: int) -> None:
        """Vehicles and roofs, sorted by how far above or below the camera they are."""
        todo: list[tuple[float, Callable[[], None]]] = []
        for roof, sprite in self._roofs:
            corners = self._roof_corners(roof)
            away = abs(float(corners[2, 0] - view.center[2]))
            todo.append((away, lambda roof=roof, sprite=sprite: self._draw_roof(image, view, roof, sprite)))  # type: ignore[misc]
        for i in self._near_vehicles(view, poses):
            if i != me:
                away = abs(float(poses.pos[2, i] - view.center[2]))
                todo.append((away, lambda i=i: self._draw_vehicle(image, view, poses, i)))  # type: ignore[misc]
        for _, paint in sorted(todo, key=lambda each: -each[0]):
            paint()

    def _near_vehicles(self, view: View, poses: Poses) -> list[int]:
        """Vehicles that may be in the picture."""
        at = view.to_camera @ (poses.pos - view.center[:, None])
        reach = np.array([figure.reach for figure in self.figures])
        width, height = view.size
        side = max(width, height) / float(view.k[0, 0])
        aside = np.maximum(np.abs(at[0]), np.abs(at[1]))
        close = (at[2] > -reach) & (aside < np.maximum(at[2], 0.0) * side + 2.0 * reach)
        return [int(i) for i in np.flatnonzero(close)]

    def _draw_vehicle(self, image: Image, view: View, poses: Poses, i: int) -> None:
        figure, pos, rotation = self.figures[i], poses.pos[:, i], quat_matrix(poses.q[:, i])
        distance = [float(np.linalg.norm(_middle(box, pos, rotation) - view.center)) for box in figure.boxes]
        for k in sorted(range(len(distance)), key=lambda k: -distance[k]):
            self._draw_box(image, view, figure.boxes[k], pos, rotation)
        sprite = figure.spinning if poses.spinning[i] else figure.sprite
        if sprite is not None:
            center = pos - rotation[:, 2] * figure.height
            draw(image, sprite, view.plane(center, rotation[:, 0], rotation[:, 1]))
        if figure.pad is not None:
            forward, right, up = figure.pad_at
            center = pos + rotation @ np.array([forward, right, -up])
            if float(rotation[:, 2] @ (center - view.center)) > 0.0:  # from below it is not seen
                draw(image, figure.pad, view.plane(center, rotation[:, 0], rotation[:, 1]))

    def _draw_box(self, image: Image, view: View, box: Box, pos: Array, rotation: Array) -> None:
        corners = _corners(box, pos, rotation)
        seen = view.project(corners)
        for axis, sign, order in FACES:
            normal = rotation[:, axis] * (sign if axis < 2 else -sign)  # the third axis is down, a box's is up
            middle = corners[:, list(order)].mean(1)
            if float(normal @ (middle - view.center)) >= 0.0:
                continue
            light = AMBIENT + (1.0 - AMBIENT) * max(0.0, float(normal @ self._sun))
            blue, green, red = (light * c for c in box.color)
            fill(image, seen[:, list(order)], (blue, green, red))

    def _draw_roof(self, image: Image, view: View, roof: Roof, sprite: Sprite) -> None:
        center = self._roof_corners(roof).mean(1)
        heading = math.radians(roof.heading_deg)
        along = np.array([math.cos(heading), math.sin(heading), 0.0])
        across = np.array([-math.sin(heading), math.cos(heading), 0.0])
        draw(image, sprite, view.plane(center, along, across))

    def _roof_corners(self, roof: Roof) -> Array:
        """(3, 4) NED."""
        backdrop = self.backdrop
        middle = backdrop.origin + roof.center[0] * backdrop.north + roof.center[1] * backdrop.east
        turn = _placing((0.0, 0.0), math.radians(roof.heading_deg))[:2, :2]
        a, b = roof.size[0] / 2.0, roof.size[1] / 2.0
        flat = turn @ np.array([[a, a, -a, -a], [-b, b, b, -b]])
        corners = np.vstack([flat, np.zeros(4)]) + middle[:, None]
        corners[2] = middle[2] - roof.height_m
        return corners


def _placing(position: tuple[float, float], heading: float) -> Array:
    """(3, 3): (ahead, right, 1) of something that lies there -> (north, east, 1)."""
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, position[0]], [s, c, position[1]], [0.0, 0.0, 1.0]])


def _middle(box: Box, pos: Array, rotation: Array) -> Array:
    forward, right, up = box.center
    result: Array = pos + rotation @ np.array([forward, right, -up])
    return result


def _corners(box: Box, pos: Array, rotation: Array) -> Array:
    """(3, 8) NED."""
    offsets = CORNERS * np.array(box.half)[:, None]
    offsets[2] *= -1.0
    result: Array = _middle(box, pos, rotation)[:, None] + rotation @ offsets
    return result
