"""The ground's texture as square tiles at powers of two of the texel's size, made when they are first looked at.

Roads and areas are drawn into the tiles; a bounded number of tiles is kept.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.camera.coverage import Grid, box, dashes, disc, over, span, turned
from zmav.sim.camera.materials import mean_color, paint, texel_m
from zmav.sim.camera.scene import Area, Road, Scene

Image = NDArray[np.uint8]

TILE = 256  # texels
TOP = 15  # the coarsest level: 33 m a texel
MOST_TILES = 384  # 100 MB
PAINT = (222.0, 226.0, 226.0)  # of lines on roads
LINE_M = 0.12
DASH_M, DASH_PERIOD_M = 3.0, 9.0
EDGE_INSET_M = 0.15


class Ground:
    """Tiles of one scene, for any number of cameras in any thread."""

    def __init__(self, scene: Scene, seed: int, most: int = MOST_TILES) -> None:
        self.scene = scene
        self.seed = seed
        self._most = most
        self._tiles: OrderedDict[tuple[int, int, int], Image] = OrderedDict()
        self._lock = threading.Lock()
        self.made = 0
        """tiles made so far"""

    @property
    def color(self) -> tuple[float, float, float]:
        """BGR of the ground from afar."""
        return mean_color(self.scene.ground)

    def block(self, level: int, x: int, y: int, columns: int, rows: int) -> Image:
        """(rows * TILE, columns * TILE, 4): tiles ``x`` and on to the east, ``y`` and on to the south."""
        out = np.empty((rows * TILE, columns * TILE, 4), dtype=np.uint8)
        for j in range(rows):
            for i in range(columns):
                out[j * TILE : (j + 1) * TILE, i * TILE : (i + 1) * TILE] = self.tile(level, x + i, y + j)
        return out

    def tile(self, level: int, x: int, y: int) -> Image:
        """(TILE, TILE, 4) BGR and a byte that is not used: OpenCV warps four bytes in half the time that three take."""
        key = (level, x, y)
        with self._lock:
            found = self._tiles.get(key)
            if found is not None:
                self._tiles.move_to_end(key)
                return found
        made = self._make(level, x * TILE, y * TILE)
        with self._lock:
            self.made += 1
            self._tiles[key] = made
            while len(self._tiles) > self._most:
                self._tiles.popitem(last=False)
        return made

    def _make(self, level: int, x: int, y: int) -> Image:
        scene, s = self.scene, texel_m(level)
        picture = paint(scene.ground, self.seed, level, x, y, TILE, TILE)
        north0, east0 = -(y + 0.5 * TILE) * s, (x + 0.5 * TILE) * s  # the tile's middle
        near = 0.5 * TILE * s * math.sqrt(2.0)
        # Coordinates about the tile's middle: single precision holds there.
        offset = (np.arange(TILE, dtype=np.float32) + np.float32(0.5 - 0.5 * TILE)) * np.float32(s)
        north, east = np.repeat(-offset[:, None], TILE, 1), np.repeat(offset[None, :], TILE, 0)

        def place(point: tuple[float, float]) -> tuple[float, float]:
            return point[0] - north0, point[1] - east0

        for area in scene.areas:
            center = place(area.center)
            if math.hypot(*center) < near + math.hypot(*area.size):
                cover = _area(area, center, north, east, s)
                over(picture, cover, paint(area.ground, self.seed, level, x, y, TILE, TILE))
        for road in scene.roads:
            points = [place(point) for point in road.points]
            if min(_distance(a, b) for a, b in pairwise(points)) < near + road.width_m:
                surface = paint(road.ground, self.seed, level, x, y, TILE, TILE)
                _draw_road(road, points, picture, north, east, s, surface)
        np.clip(picture, 0.0, 255.0, out=picture)
        tile: Image = cv2.cvtColor(np.rint(picture).astype(np.uint8), cv2.COLOR_BGR2BGRA).astype(np.uint8, copy=False)
        return tile


def _area(area: Area, center: tuple[float, float], north: Grid, east: Grid, s: float) -> Grid:
    along, across = turned(north, east, center, math.radians(area.heading_deg))
    return box(along, across, area.size[0] / 2.0, area.size[1] / 2.0, s)


def _distance(a: tuple[float, float], b: tuple[float, float]) -> float:
    """From the origin to the segment between two points."""
    n, e = b[0] - a[0], b[1] - a[1]
    share = min(max(-(a[0] * n + a[1] * e) / max(n * n + e * e, 1e-12), 0.0), 1.0)
    return math.hypot(a[0] + share * n, a[1] + share * e)


def _draw_road(
    road: Road, points: list[tuple[float, float]], picture: Grid, north: Grid, east: Grid, s: float, surface: Grid
) -> None:
    """The carriageway first, then the lines on it: those at its edges keep their distance from the middle line."""
    half = road.width_m / 2.0
    covers, lines = np.zeros_like(north), np.zeros_like(north)
    away = np.full_like(north, np.inf)  # from the middle line
    for a, b in pairwise(points):
        length = math.hypot(b[0] - a[0], b[1] - a[1])
        along, across = turned(north, east, a, math.atan2(b[1] - a[1], b[0] - a[0]))
        np.maximum(covers, box(along - length / 2.0, across, length / 2.0, half, s), out=covers)
        beside = (along >= -s) & (along <= length + s)
        np.minimum(away, np.where(beside, np.abs(across), np.inf), out=away)
        if road.center_line != "none":
            marks = span(across, -LINE_M / 2.0, LINE_M / 2.0, s)
            if road.center_line == "dashed":
                marks = marks * dashes(along, DASH_PERIOD_M, DASH_M, s)
            np.maximum(lines, marks * span(along, 0.0, length, s), out=lines)
    for point in points[1:-1]:  # bends are round
        dn, de = north - point[0], east - point[1]
        np.maximum(covers, disc(dn, de, half, s), out=covers)
        np.minimum(away, np.hypot(dn, de), out=away)
    if road.edge_lines:
        edge = half - EDGE_INSET_M
        np.maximum(lines, span(away, edge - LINE_M / 2.0, edge + LINE_M / 2.0, s), out=lines)
    over(picture, covers, surface)
    over(picture, lines * covers, PAINT)
