"""The ground as a view sees it, out to the horizon, and the sky above."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array
from zmav.sim.camera.ground import TILE, TOP, Ground
from zmav.sim.camera.materials import FINEST_M, texel_m
from zmav.sim.camera.projection import View
from zmav.sim.camera.sprites import SHIFT
from zmav.sim.environment import Terrain

Image = NDArray[np.uint8]

SHARPNESS = 0.85  # texels per pixel, at the middle of a level's range
GRAZING = 0.06  # sine of the angle below which texels grow no longer for the slant
ONE_LEVEL = 0.85  # powers of two that a level may be off, so that a picture needs only one
MOST_BLOCK = 400  # tiles of one level in one picture
HAZE = (214.0, 208.0, 200.0)  # BGR at the horizon
ZENITH = (196.0, 138.0, 84.0)
HAZY_FROM = 0.03  # of the haze's distance: nearer than that none is seen
FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


class Backdrop:
    """Draws the ground of one scene for one camera. ``terrain``: the plane it lies on."""

    def __init__(self, ground: Ground, terrain: Terrain) -> None:
        self._ground = ground
        self.origin = np.array([0.0, 0.0, terrain.down_m])
        # The plane's two directions go one metre to the north and to the east, over its slope.
        self.north = np.array([1.0, 0.0, -terrain.slope_north])
        self.east = np.array([0.0, 1.0, -terrain.slope_east])
        self.down: Array = -np.array(terrain.normal)
        """unit vector into the ground"""
        self._blocks: dict[int, tuple[tuple[int, int, int, int], Image]] = {}
        self._norms: Array | None = None

    def height(self, point: Array) -> float:
        """Of a point (3,) NED above the plane, along its normal."""
        return float(self.down @ (self.origin - point))

    def plane(self, view: View) -> Array:
        """(3, 3): (north, east, 1) on the ground -> (u w, v w, w)."""
        return view.plane(self.origin, self.north, self.east)

    def draw(self, image: Image, view: View) -> None:
        """Fill ``image`` (h, w, 3) BGR."""
        height, row = self.height(view.center), view.ray_row(self.down)
        scale = SHARPNESS * height / float(view.k[0, 0])
        farthest = _dip(scale, texel_m(TOP))
        width, rows = view.size
        rim = np.array([[-1.0, width, width, -1.0], [-1.0, -1.0, rows, rows], [1.0, 1.0, 1.0, 1.0]])
        dips = row @ rim
        low, high = float(dips.min()), float(dips.max())
        if low < farthest:
            image[:] = np.rint(self._ground.color)
        if high > farthest:
            plane = self.plane(view)
            for level, below, above in self._bands(scale, max(low, farthest), high):
                self._draw_band(image, plane, level, _between(rim, row, below, above))
        if height / max(low, 1e-9) > HAZY_FROM * self._ground.scene.haze_m:
            self._haze(image, view, row, height)

    def _bands(self, scale: float, low: float, high: float) -> list[tuple[int, float, float]]:
        """Levels, far ones first, each with the dips between which it is drawn."""
        near, far = _level(scale, high), _level(scale, low)
        if far - near <= 2.0 * ONE_LEVEL:
            return [(_whole((near + far) / 2.0), low, high)]
        bands = []
        for level in range(_whole(far), _whole(near) - 1, -1):
            above = high if level == _whole(near) else _dip(scale, texel_m(level) / math.sqrt(2.0))
            below = low if level == _whole(far) else _dip(scale, texel_m(level) * math.sqrt(2.0))
            bands.append((level, max(below, low), min(above, high)))
        return bands

    def _draw_band(self, image: Image, plane: Array, level: int, outline: Array) -> None:
        """Draw one level within ``outline`` (3, N), a convex polygon of pixels."""
        if outline.shape[1] < 3:
            return
        rows, width = image.shape[:2]
        x0, y0 = max(math.floor(outline[0].min()), 0), max(math.floor(outline[1].min()), 0)
        x1, y1 = min(math.ceil(outline[0].max()) + 1, width), min(math.ceil(outline[1].max()) + 1, rows)
        if x0 >= x1 or y0 >= y1:
            return
        spots = np.linalg.inv(plane) @ outline
        block, to_ground = self._block(level, spots[0] / spots[2], spots[1] / spots[2])
        shifted = np.array([[1.0, 0.0, -x0], [0.0, 1.0, -y0], [0.0, 0.0, 1.0]]) @ plane @ to_ground
        matrix = np.linalg.inv(shifted)
        part = image[y0:y1, x0:x1]
        if outline.shape[1] == 4 and (x1 - x0, y1 - y0) == (width, rows) and np.ptp(outline[0]) == width + 1.0:
            warped = cv2.warpPerspective(block, matrix, (width, rows), flags=FLAGS, borderMode=cv2.BORDER_REPLICATE)
            cv2.cvtColor(warped, cv2.COLOR_BGRA2BGR, dst=part)
            return
        warped = cv2.warpPerspective(block, matrix, (x1 - x0, y1 - y0), flags=FLAGS, borderMode=cv2.BORDER_REPLICATE)
        band = cv2.cvtColor(warped, cv2.COLOR_BGRA2BGR)
        mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        corners = (outline[:2].T - (x0, y0)) * (1 << SHIFT)
        cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), (255.0,), cv2.LINE_8, SHIFT)
        cv2.copyTo(band, mask, part)

    def _block(self, level: int, north: Array, east: Array) -> tuple[Image, Array]:
        """A picture of the ground that holds these places, and (3, 3) its (column, row, 1) -> (north, east, 1)."""
        while True:
            s = texel_m(level)
            side = TILE * s
            x0, x1 = math.floor(east.min() / side - 0.01), math.floor(east.max() / side + 0.01)
            y0, y1 = math.floor(-north.max() / side - 0.01), math.floor(-north.min() / side + 0.01)
            columns, rows = x1 - x0 + 1, y1 - y0 + 1
            if columns * rows <= MOST_BLOCK or level >= TOP:
                break
            level += 1
        wanted = (x0, y0, min(columns, MOST_BLOCK), min(rows, MOST_BLOCK))
        kept = self._blocks.get(level)
        if kept is None or kept[0] != wanted:
            if len(self._blocks) > 2 and level not in self._blocks:
                self._blocks.pop(next(iter(self._blocks)))
            self._blocks[level] = kept = (wanted, self._ground.block(level, *wanted))
        first_row, first_column = (y0 * TILE + 0.5) * s, (x0 * TILE + 0.5) * s
        return kept[1], np.array([[0.0, -s, -first_row], [s, 0.0, first_column], [0.0, 0.0, 1.0]])

    def _haze(self, image: Image, view: View, row: Array, height: float) -> None:
        """Far ground fades into the haze, and above the horizon is the sky."""
        width, rows = view.size
        u, v = np.arange(width, dtype=np.float32), np.arange(rows, dtype=np.float32)
        dip: NDArray[np.floating[Any]] = (np.float32(row[0]) * u + np.float32(row[2]))[None, :] + (
            np.float32(row[1]) * v
        )[:, None]
        if self._norms is None:
            x, y = (u - view.k[0, 2]) / view.k[0, 0], (v - view.k[1, 2]) / view.k[1, 1]
            self._norms = np.sqrt(1.0 + (x * x)[None, :] + (y * y)[:, None]).astype(np.float32)
        slope = dip / self._norms  # sine of the angle below the horizon
        distance = height / np.maximum(slope, 1e-6)
        clear = np.exp(-distance / self._ground.scene.haze_m).astype(np.float32)
        clear[slope <= 0.0] = 0.0
        blue = np.clip(-slope / 0.6, 0.0, 1.0)[..., None]
        air = np.array(HAZE, dtype=np.float32) + blue * (np.array(ZENITH, np.float32) - np.array(HAZE, np.float32))
        mixed = air + (image - air) * clear[..., None]
        np.rint(mixed, out=mixed)
        image[:] = mixed.astype(np.uint8)


def _level(scale: float, dip: float) -> float:
    """The level, as a real number, of ground seen at that ``dip``: the part of a ray along the ground's normal."""
    texel = scale / dip / math.sqrt(min(max(dip, GRAZING), 1.0))
    return math.log2(texel / FINEST_M)


def _whole(level: float) -> int:
    return min(max(round(level), 0), TOP)


def _dip(scale: float, texel: float) -> float:
    """The dip at which ground is drawn with that texel: the inverse of :func:`_level`."""
    ratio = scale / texel
    if ratio >= 1.0:
        return ratio
    dip = float(ratio ** (2.0 / 3.0))
    return dip if dip >= GRAZING else ratio / math.sqrt(GRAZING)


def _between(rim: Array, row: Array, low: float, high: float) -> Array:
    """The part of a convex polygon (3, N; third row ones) where ``row`` gives values from ``low`` to ``high``."""
    for sign, limit in ((1.0, low), (-1.0, -high)):
        values = sign * (row @ rim) - limit
        if (values >= -1e-12).all():
            continue
        kept = []
        for i in range(rim.shape[1]):
            j = (i + 1) % rim.shape[1]
            if values[i] >= 0.0:
                kept.append(rim[:, i])
            if (values[i] >= 0.0) != (values[j] >= 0.0):
                kept.append(rim[:, i] + (rim[:, j] - rim[:, i]) * (values[i] / (values[i] - values[j])))
        if len(kept) < 3:
            return np.empty((3, 0))
        rim = np.array(kept).T
    return rim
