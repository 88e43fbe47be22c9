"""The ground as a view sees it, out to the horizon, and the sky above.

Its texture is noise whose strength falls with the spatial frequency, as that of natural surfaces does (Field,
"Relations between the statistics of natural images", JOSA A 4(12), 1987). It is made once, repeats every
:data:`PERIOD_M`, and is kept at falling sizes, each half the last one's, of which the one that fits the distance is
warped to the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.arrays import Array
from zmav.sim.camera.projection import View
from zmav.sim.camera.scene import Scene
from zmav.sim.camera.sprites import fill

Image = NDArray[np.uint8]

DOWN = np.array([0.0, 0.0, 1.0])
SIDE = 1024  # texels
FINEST_M = 0.01  # one texel's side
PERIOD_M = SIDE * FINEST_M
TOP = 10  # the last level: one texel, the mean colour
SHARPNESS = 0.85  # texels per pixel, at the middle of a level's range
GRAZING = 0.06  # sine of the angle below which texels grow no longer for the slant
ONE_LEVEL = 0.85  # powers of two that a level may be off, so that a picture needs only one
SKY = (206.0, 188.0, 164.0)
PAINT = (222.0, 226.0, 226.0)  # of lines on roads
LINE_M, DASH_M, DASH_PERIOD_M, EDGE_INSET_M = 0.12, 3.0, 9.0, 0.15
# Of each ground, BGR: the mean, and what one standard deviation of brightness and of hue adds.
COLOURS = {
    "grass": ((52.0, 104.0, 88.0), (16.0, 27.0, 23.0), (-1.0, 2.0, 6.0)),
    "asphalt": ((88.0, 86.0, 85.0), (18.0, 18.0, 18.0), (-1.0, 0.0, 1.0)),
}


class GroundTexture:
    """The textures of one scene, for any number of cameras."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene = scene
        self.levels = _texture(scene.ground, seed)


def _texture(name: str, seed: int) -> list[Image]:
    """(SIDE, SIDE, 4) BGR and a byte that is not used (OpenCV warps four bytes in half the time that three take), and
    its halves.
    """
    rng = np.random.default_rng([seed, *name.encode()])
    frequency = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None, :])
    frequency[0, 0] = np.inf  # no mean
    noises = []
    for _ in range(2):
        spectrum = np.fft.rfft2(rng.standard_normal((SIDE, SIDE))) / frequency**0.8
        noise = np.fft.irfft2(spectrum, (SIDE, SIDE))
        noises.append(noise / noise.std())
    mean, light, hue = (np.array(each) for each in COLOURS[name])
    picture = mean + noises[0][..., None] * light + noises[1][..., None] * hue
    level = cv2.cvtColor(np.clip(np.rint(picture), 0.0, 255.0).astype(np.uint8), cv2.COLOR_BGR2BGRA)
    levels = [np.asarray(level, dtype=np.uint8)]
    for _ in range(TOP):
        side = len(levels[-1]) // 2
        levels.append(np.asarray(cv2.resize(levels[-1], (side, side), interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return levels


class Backdrop:
    """Draws the ground of one scene for one camera."""

    def __init__(self, ground: GroundTexture) -> None:
        self._ground = ground

    def draw(self, image: Image, view: View, plane: Array) -> None:
        """Fill ``image`` (h, w, 3) BGR. ``plane``: (3, 3) (north, east, 1) on the ground -> (u w, v w, w)."""
        width, rows = view.size
        row = view.ray_row(DOWN)
        scale = SHARPNESS * -view.center[2] / float(view.k[0, 0])
        corners = row @ np.array([[0, width, width, 0], [0, 0, rows, rows], [1, 1, 1, 1]])
        farthest = _dip(scale, FINEST_M * 2.0**TOP)
        low, high = max(float(corners.min()), farthest), float(corners.max())
        if high <= 0.0:
            image[:] = np.rint(SKY)
            return
        image[:] = self._ground.levels[TOP][0, 0, :3]
        if high > farthest:
            nearest, last = _level(scale, high), _level(scale, low)
            if corners.min() > farthest and last - nearest <= 2.0 * ONE_LEVEL:
                image[:] = self._warped(plane, view, _whole((nearest + last) / 2.0))
            else:
                self._draw_levels(image, plane, view, scale, (_whole(nearest), _whole(last)))
        if self._ground.scene.roads:
            self._draw_roads(image, plane)
        if corners.min() <= 0.0:
            image[_dips(row, view.size) <= 0.0] = np.rint(SKY)

    def _draw_levels(self, image: Image, plane: Array, view: View, scale: float, levels: tuple[int, int]) -> None:
        """Each level where its texels are about as large as the pixels."""
        dips = _dips(view.ray_row(DOWN), view.size)
        for level in range(levels[0], levels[1] + 1):
            near = math.inf if level == levels[0] else _dip(scale, FINEST_M * 2.0 ** (level - 0.5))
            far = _dip(scale, FINEST_M * 2.0 ** (level + 0.5))
            mask = ((dips > far) & (dips <= near)).astype(np.uint8)
            if mask.any():
                cv2.copyTo(self._warped(plane, view, level), mask, image)

    def _warped(self, plane: Array, view: View, level: int) -> Image:
        """(h, w, 3): one level over the whole picture."""
        s = FINEST_M * 2.0**level
        # Texture columns go east and rows south. It begins again near the camera: OpenCV reckons in 16 bits.
        north, east = (math.floor(c / PERIOD_M) * PERIOD_M for c in view.center[:2])
        to_ground = np.array([[0.0, -s, north - 0.5 * s], [s, 0.0, east + 0.5 * s], [0.0, 0.0, 1.0]])
        matrix = np.linalg.inv(plane @ to_ground)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(
            self._ground.levels[level], matrix, view.size, flags=flags, borderMode=cv2.BORDER_WRAP
        )
        return np.asarray(cv2.cvtColor(warped, cv2.COLOR_BGRA2BGR), dtype=np.uint8)

    def _draw_roads(self, image: Image, plane: Array) -> None:
        """The carriageways first, as grey as asphalt, then the lines on them."""
        grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        for road in self._ground.scene.roads:
            half, edge = road.width_m / 2.0, road.width_m / 2.0 - EDGE_INSET_M
            ways = [_way(a, b) for a, b in pairwise(road.points)]
            mask = np.zeros(image.shape[:2], dtype=np.uint8)
            for way, length in ways:
                fill(mask, plane @ way @ _rectangle(0.0, length, 0.0, half), (255.0,))
            cv2.copyTo(grey, mask, image)
            for way, length in ways:
                for side in (-edge, edge):
                    fill(image, plane @ way @ _rectangle(0.0, length, side, LINE_M / 2.0), PAINT)
                for start in np.arange(0.0, length, DASH_PERIOD_M):
                    end = min(start + DASH_M, length)
                    fill(image, plane @ way @ _rectangle(float(start), end, 0.0, LINE_M / 2.0), PAINT)


def _way(a: Sequence[float], b: Sequence[float]) -> tuple[Array, float]:
    """(3, 3): (along, to the right, 1) from one point to another -> (north, east, 1); and how far it is, m."""
    length = max(math.dist(a, b), 1e-9)
    c, s = (b[0] - a[0]) / length, (b[1] - a[1]) / length
    return np.array([[c, -s, a[0]], [s, c, a[1]], [0.0, 0.0, 1.0]]), length


def _rectangle(start: float, end: float, middle: float, half: float) -> Array:
    """(3, 4): corners (along, to the right, 1)."""
    low, high = middle - half, middle + half
    return np.array([[start, start, end, end], [low, high, high, low], [1.0, 1.0, 1.0, 1.0]])


def _dips(row: Array, size: tuple[int, int]) -> NDArray[np.float32]:
    """(h, w): of each pixel's ray the part along the ground's normal."""
    u, v = (np.arange(n, dtype=np.float32) for n in size)
    return np.asarray((row[1] * v + row[2])[:, None] + row[0] * u, dtype=np.float32)


def _level(scale: float, dip: float) -> float:
    """The level, as a real number, of ground seen at that ``dip``."""
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
