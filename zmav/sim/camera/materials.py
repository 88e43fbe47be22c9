"""The look of grounds: colours, and a texture of octaves of value noise from a hash, which never repeats.

The noise at a texel is the sum of one lattice for each power of two from that texel's size up to a kilometre, each
lattice smoothed to the next finer one (Perlin, "An Image Synthesizer", 1985; Ebert et al., "Texturing and Modeling",
3rd ed., ch. 2). A coarser texel simply lacks the finer lattices, so pictures from 1 m and from 100 m agree. Everything
is computed from the seed and the place alone: no pictures of others are used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.camera.coverage import Grid, dashes

FINEST_M = 0.001  # texel of level 0; each level's is twice the one below's
TOP_LEVEL = 20  # lattice of a kilometre: nothing varies more slowly
BLADE_M = 0.05  # length of a blade of grass
BLADES_UP_TO = 4  # levels that show blades by themselves
MOST_TAPS = 31
ANGLES = (0.35, 1.1, 1.9, 2.7)  # of blades, radians
BLADE_MEAN, BLADE_SPREAD = 1.03, 0.70  # of the greatest of four standard normals (mean, standard deviation)


class Material(NamedTuple):
    """A ground's colours (BGR, 0 to 255) and the strength of its noise at some lattice sizes in metres."""

    base: tuple[float, float, float]
    light: tuple[float, float, float]
    """what one unit of brightness adds"""
    hue: tuple[float, float, float]
    """what one unit of the second noise adds: patches of another colour"""
    light_at: tuple[tuple[float, float], ...]
    hue_at: tuple[tuple[float, float], ...]
    blades: float = 0.0
    grid_m: float = 0.0
    """side of square slabs, and the width of their joints"""
    joint_m: float = 0.0
    slab_spread: float = 0.0


MATERIALS = {
    "grass": Material(
        (52.0, 104.0, 88.0),
        (0.62, 1.05, 0.88),
        (-0.10, 0.30, 1.0),
        ((0.001, 9.0), (0.004, 14.0), (0.016, 16.0), (0.06, 10.0), (0.25, 6.0), (2.0, 4.0), (16.0, 4.0), (500.0, 3.0)),
        ((0.004, 4.0), (0.03, 5.0), (0.25, 3.0), (2.0, 2.5), (16.0, 3.0), (500.0, 3.0)),
        blades=17.0,
    ),
    "asphalt": Material(
        (88.0, 86.0, 85.0),
        (1.0, 1.0, 1.0),
        (-0.6, 0.1, 0.7),
        ((0.001, 10.0), (0.004, 22.0), (0.010, 16.0), (0.03, 6.0), (0.25, 3.0), (2.0, 3.0), (16.0, 3.0), (500.0, 1.5)),
        ((0.004, 3.0), (0.25, 0.7), (4.0, 0.9), (500.0, 0.7)),
    ),
    "sand": Material(
        (128.0, 170.0, 196.0),
        (0.9, 1.0, 1.05),
        (-0.7, 0.0, 0.6),
        ((0.001, 14.0), (0.004, 9.0), (0.03, 6.0), (0.10, 10.0), (0.4, 6.0), (2.0, 4.0), (16.0, 4.0), (500.0, 3.0)),
        ((0.001, 4.0), (0.03, 1.5), (1.0, 1.5), (16.0, 2.0), (500.0, 1.5)),
    ),
    "tiles": Material(
        (128.0, 140.0, 152.0),
        (1.0, 1.0, 1.0),
        (-0.6, 0.0, 0.7),
        ((0.001, 4.0), (0.008, 5.0), (0.03, 4.0), (0.25, 3.0), (2.0, 4.0), (16.0, 3.0), (500.0, 2.0)),
        ((0.008, 1.5), (0.25, 1.2), (4.0, 1.4), (500.0, 0.8)),
        grid_m=0.30,
        joint_m=0.006,
        slab_spread=11.0,
    ),
    "concrete": Material(
        (158.0, 164.0, 166.0),
        (1.0, 1.0, 1.0),
        (-0.5, 0.0, 0.5),
        ((0.001, 5.0), (0.004, 6.0), (0.03, 3.0), (0.25, 4.0), (1.0, 5.0), (8.0, 3.5), (500.0, 1.5)),
        ((0.25, 1.0), (4.0, 1.3), (500.0, 0.7)),
        grid_m=4.0,
        joint_m=0.012,
        slab_spread=5.0,
    ),
}


def texel_m(level: int) -> float:
    """Side of that level's texels, metres."""
    return FINEST_M * float(1 << level)


def paint(name: str, seed: int, level: int, x: int, y: int, width: int, height: int) -> Grid:
    """(height, width, 3) BGR of that ground: texels ``x`` to the east and ``y`` to the south of the world's origin."""
    material = MATERIALS[name]
    salt = (seed * 31 + list(MATERIALS).index(name) * 7919) & 0xFFFFFFFF
    noise = _field(material, salt, level, x, y, width, height)
    if material.blades and level <= BLADES_UP_TO:
        noise[..., 0] += material.blades * _blades(salt, level, x, y, width, height)
    mix = np.array([material.light, material.hue], dtype=np.float32).T
    picture = _floats(cv2.transform(noise, mix))
    picture += np.array(material.base, dtype=np.float32)
    if material.grid_m:
        _slabs(material, salt, level, picture, x, y)
    return picture


def mean_color(name: str) -> tuple[float, float, float]:
    """BGR of that ground from afar."""
    material = MATERIALS[name]
    dark = 1.0 - 2.0 * material.joint_m / material.grid_m * 0.45 if material.grid_m else 1.0
    blue, green, red = (dark * c for c in material.base)
    return blue, green, red


def strength(table: tuple[tuple[float, float], ...], lattice_m: float) -> float:
    """Of the lattice of that size: between the table's entries by the logarithm of the size."""
    sizes = [math.log(size) for size, _ in table]
    return float(np.interp(math.log(lattice_m), sizes, [value for _, value in table]))


def hashed(salt: int, level: int, x: int, y: int, width: int, height: int) -> NDArray[np.uint32]:
    """(height, width) well-mixed 32-bit numbers, by the cell alone (finalizer of MurmurHash3)."""
    mask = 0xFFFFFFFF
    across = (np.arange(x, x + width, dtype=np.int64) & mask).astype(np.uint32) * np.uint32(0x9E3779B1)
    down = (np.arange(y, y + height, dtype=np.int64) & mask).astype(np.uint32) * np.uint32(0x85EBCA6B)
    h = (across[None, :] ^ (down[:, None] + np.uint32(0x27D4EB2F))) + np.uint32((salt + level * 0x632BE5AB) & mask)
    h ^= h >> np.uint32(16)
    h *= np.uint32(0x85EBCA6B)
    h ^= h >> np.uint32(13)
    h *= np.uint32(0xC2B2AE35)
    h ^= h >> np.uint32(16)
    return h


def white(salt: int, level: int, x: int, y: int, width: int, height: int) -> Grid:
    """(height, width, 2) independent numbers, even in [-1, 1)."""
    halves = hashed(salt, level, x, y, width, height).view(np.uint16).reshape(height, width, 2)
    result: Grid = halves.astype(np.float32) * np.float32(1.0 / 32768.0) - np.float32(1.0)
    return result


def _field(material: Material, salt: int, level: int, x: int, y: int, width: int, height: int) -> Grid:
    """(height, width, 2): the noises of brightness and hue, of all lattices from this level's up."""
    size = texel_m(level)
    own = white(salt, level, x, y, width, height)
    own *= np.array([strength(material.light_at, size), strength(material.hue_at, size)], dtype=np.float32)
    if level >= TOP_LEVEL:
        return own
    # Two cells more on every side: the smoothing looks that far.
    left, top = (x >> 1) - 2, (y >> 1) - 2
    columns, rows = ((x + width + 1) >> 1) + 2 - left, ((y + height + 1) >> 1) + 2 - top
    coarse = _field(material, salt, level + 1, left, top, columns, rows)
    smooth = _floats(cv2.resize(coarse, (2 * columns, 2 * rows), interpolation=cv2.INTER_CUBIC))
    dx, dy = x - 2 * left, y - 2 * top
    own += smooth[dy : dy + height, dx : dx + width]
    return own


def _floats(image: object) -> Grid:
    """What OpenCV gives, by its true type."""
    return np.asarray(image, dtype=np.float32)


def _blades(salt: int, level: int, x: int, y: int, width: int, height: int) -> Grid:
    """(height, width): crossing strokes, as blades of grass from above; mean 0, spread 1, weaker where texels are as
    long as blades.
    """
    length = BLADE_M / texel_m(level)
    taps = min(MOST_TAPS, 2 * int(length / 2.0) + 1)
    if taps < 3:
        return np.zeros((height, width), dtype=np.float32)
    m = taps // 2
    best: Grid = np.full((height, width), -np.inf, dtype=np.float32)
    for i, angle in enumerate(ANGLES):
        grain = white(salt + 977 * (i + 1), level, x - m, y - m, width + 2 * m, height + 2 * m)[..., 0]
        kernel = np.zeros((taps, taps), dtype=np.float32)
        dx, dy = m * math.cos(angle), m * math.sin(angle)
        ends = [(round((m + k * dx) * 256), round((m + k * dy) * 256)) for k in (-1.0, 1.0)]
        cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_8, 8)
        kernel *= math.sqrt(3.0 / float((kernel * kernel).sum()))
        stroke: Grid = _floats(cv2.filter2D(grain, -1, kernel))[m : m + height, m : m + width]
        best = np.maximum(best, stroke)
    fade = min(1.0, (taps - 1) / 12.0)
    result: Grid = (best - np.float32(BLADE_MEAN)) * np.float32(fade / BLADE_SPREAD)
    return result


def _slabs(material: Material, salt: int, level: int, picture: Grid, x: int, y: int) -> None:
    """Square slabs, each a little lighter or darker, with dark joints, into ``picture`` in place."""
    height, width = picture.shape[:2]
    s, side = texel_m(level), material.grid_m
    # In double precision: kilometres away, a joint is still a joint.
    east = (np.arange(x, x + width) + 0.5) * s
    south = (np.arange(y, y + height) + 0.5) * s
    shade = max(0.0, 1.0 - s / side)
    if shade > 0.0:
        column, row = np.floor(east / side).astype(np.int64), np.floor(south / side).astype(np.int64)
        x0, y0 = int(column[0]), int(row[0])
        cells = white(salt, 99, x0, y0, int(column[-1]) - x0 + 1, int(row[-1]) - y0 + 1)[..., 0]
        picture += (cells[np.ix_(row - y0, column - x0)] * np.float32(material.slab_spread * shade))[..., None]
    joint_x = dashes(east, side, material.joint_m, s)
    joint_y = dashes(south, side, material.joint_m, s)
    open_ = np.multiply.outer(1.0 - joint_y, 1.0 - joint_x).astype(np.float32)
    picture *= np.float32(0.55) + np.float32(0.45) * open_[..., None]
