"""Ground of many kinds and what lies about on it: procedural, seeded, in metres."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

GROUNDS = ("grass", "asphalt", "sand", "tiles", "concrete", "leaves")
TILE_M = 4.0
TILE_PX = 1024
TILES = 3
"""different tiles of each kind"""
WORDS = "NAX+OETUZLFKMVWY2345789%?"
CLEAR_OF_PAD_M = 0.15


def _octaves(rng: np.random.Generator, sigmas: tuple[tuple[float, float], ...]) -> Image:
    """(TILE_PX, TILE_PX) noise that repeats without a seam: (width in texels, strength) of each octave."""
    total = np.zeros((TILE_PX, TILE_PX), dtype=np.float32)
    for sigma, strength in sigmas:
        step = max(int(sigma / 2.0), 1)
        small = rng.normal(size=(TILE_PX // step, TILE_PX // step)).astype(np.float32)
        pad = 12
        small = np.pad(small, pad, mode="wrap")
        blurred = cv2.GaussianBlur(small, (0, 0), sigma / step)[pad:-pad, pad:-pad]
        small = np.asarray(blurred, dtype=np.float32)
        small /= small.std()
        total += strength * cv2.resize(small, (TILE_PX, TILE_PX), interpolation=cv2.INTER_LINEAR)
    return total


@functools.lru_cache(maxsize=32)
def tile(kind: str, number: int) -> tuple[Image, ...]:
    """One tile of ground as pictures of halving size, (n, n, 3) BGR 0 to 255, the first ``TILE_PX`` wide."""
    rng = np.random.default_rng([77, GROUNDS.index(kind), number])
    base, spread, tint = {
        "grass": ((60, 105, 80), 20, 0.25),
        "asphalt": ((82, 80, 80), 11, 0.1),
        "sand": ((135, 175, 195), 13, 0.3),
        "tiles": ((120, 130, 150), 9, 0.3),
        "concrete": ((158, 164, 166), 8, 0.15),
        "leaves": ((45, 80, 105), 24, 0.35),
    }[kind]
    light = _octaves(rng, ((1.0, 0.7), (3.0, 0.6), (9.0, 0.4), (40.0, 0.4)))
    color = np.stack([_octaves(rng, ((4.0, 0.5), (30.0, 0.3))) for _ in range(3)], axis=-1)
    shift = np.array(base, dtype=np.float32) * rng.uniform(0.75, 1.25)
    picture = shift + spread * (light[..., None] + tint * color)
    if kind == "tiles":
        side = TILE_PX // int(rng.choice([8, 10, 16]))
        index = np.arange(TILE_PX)
        shade = rng.normal(0.0, 12.0, (64, 64)).astype(np.float32)
        picture += shade[np.ix_(index // side % 64, index // side % 64)][..., None]
        joint = (index % side < max(side // 16, 2))[:, None] | (index % side < max(side // 16, 2))[None, :]
        picture[joint] *= rng.choice([0.55, 1.3])
    elif kind == "concrete":
        for at in range(0, TILE_PX, TILE_PX // 2):
            picture[at : at + 4] *= 0.6
            picture[:, at : at + 4] *= 0.6
    elif kind == "leaves":
        for _ in range(900):
            x, y = (int(c) for c in rng.integers(0, TILE_PX, 2))
            size = (int(rng.integers(4, 16)), int(rng.integers(2, 7)))
            paint = tuple(float(c) for c in rng.uniform((20, 60, 60), (90, 170, 200)))
            cv2.ellipse(picture, (x, y), size, float(rng.uniform(0, 180)), 0, 360, paint, -1, cv2.LINE_AA)
    levels = [np.clip(picture, 0, 255)]
    while levels[-1].shape[0] > 32:
        half = levels[-1].shape[0] // 2
        levels.append(cv2.resize(levels[-1], (half, half), interpolation=cv2.INTER_AREA))
    return tuple(levels)


def lay(rng: np.random.Generator, to_picture: Array, texel_m: float, size: tuple[int, int]) -> Image:
    """A picture (height, width, 3) of bare ground. ``to_picture`` (3, 3) takes metres on the ground to pixels, one of
    which is ``texel_m`` wide.
    """
    kind = str(rng.choice(GROUNDS))
    levels = tile(kind, int(rng.integers(TILES)))
    level = min(max(round(math.log2(max(texel_m / (TILE_M / TILE_PX), 1.0))), 0), len(levels) - 1)
    picture = levels[level]
    scale = TILE_M / picture.shape[0]
    angle = rng.uniform(0, 2 * math.pi)
    c, s = math.cos(angle) * scale, math.sin(angle) * scale
    x, y = rng.uniform(-TILE_M, TILE_M, 2)
    to_ground = np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])
    # BORDER_WRAP repeats the tile without end.
    ground = cv2.warpPerspective(
        picture, to_picture @ to_ground, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    wide = cv2.resize(rng.normal(0, 1, (5, 6)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    result: Image = np.asarray(ground, dtype=np.float32)
    result *= (1.0 + 0.08 * wide)[..., None]
    return result


class Clutter:
    """Things painted on the ground of a picture, at exact places but with OpenCV's own edges."""

    def __init__(
        self, rng: np.random.Generator, picture: Image, to_picture: Array, reach_m: tuple[float, float]
    ) -> None:
        self.rng = rng
        self.picture = picture
        self.to_picture = to_picture
        self.reach = reach_m
        """half the width and half the height that the picture shows, m"""

    def scatter(self, count: int, pads: list[tuple[float, float, float]]) -> None:
        """``count`` things, none of which covers ``pads`` (x, y, radius; m)."""
        kinds = (self._blob, self._line, self._word, self._car, self._person, self._square, self._stripes)
        for _ in range(count):
            thing = kinds[int(self.rng.integers(len(kinds)))]
            x, y = self.rng.uniform(-1, 1, 2) * self.reach
            for px, py, radius in pads:
                away = math.hypot(x - px, y - py)
                clear = radius + CLEAR_OF_PAD_M
                if away < clear:
                    x, y = (px + (x - px) * clear / max(away, 1e-6), py + (y - py) * clear / max(away, 1e-6))
            thing(x, y)

    def _paint(self, bright: bool) -> tuple[float, float, float]:
        low, high = (150, 255) if bright else (10, 200)
        grey = self.rng.uniform(low, high)
        tint = self.rng.uniform(-1, 1, 3) * (20 if bright and self.rng.random() < 0.6 else 90)
        return tuple(float(c) for c in np.clip(grey + tint, 0, 255))  # type: ignore[return-value]

    def _fill(self, outlines: list[Array], color: tuple[float, float, float]) -> None:
        polygons = []
        for outline in outlines:
            points = np.column_stack([outline, np.ones(len(outline))]) @ self.to_picture.T
            if np.any(points[:, 2] <= 1e-6):
                return
            polygons.append(np.rint(points[:, :2] / points[:, 2:] * 16.0).astype(np.int32))
        cv2.fillPoly(self.picture, polygons, color, cv2.LINE_AA, 4)

    def _box(self, x: float, y: float, half: tuple[float, float], angle: float) -> Array:
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        return self._turned(corners, x, y, angle)

    @staticmethod
    def _turned(points: Array, x: float, y: float, angle: float) -> Array:
        c, s = math.cos(angle), math.sin(angle)
        result: Array = points @ np.array([[c, s], [-s, c]]) + (x, y)
        return result

    def _blob(self, x: float, y: float) -> None:
        turn = np.linspace(0, 2 * math.pi, 24, endpoint=False)
        radius = self.rng.uniform(0.04, 0.13)
        wave = 1.0 + 0.3 * self.rng.uniform(-1, 1) * np.cos(turn * self.rng.integers(2, 6))
        outline = np.column_stack([np.cos(turn), np.sin(turn) * self.rng.uniform(0.4, 1.0)]) * (radius * wave)[:, None]
        self._fill([self._turned(outline, x, y, self.rng.uniform(0, 6.3))], self._paint(True))

    def _square(self, x: float, y: float) -> None:
        half = tuple(self.rng.uniform(0.04, 0.13, 2))
        self._fill([self._box(x, y, half, self.rng.uniform(0, 6.3))], self._paint(self.rng.random() < 0.6))

    def _line(self, x: float, y: float) -> None:
        side = 1.0 if self.rng.random() < 0.5 else -1.0
        angle = math.atan2(y, x) + math.pi / 2.0 if side > 0 else self.rng.uniform(0, 6.3)
        length = self.rng.uniform(0.3, 1.2)
        self._fill([self._box(x, y, (0.1 * length, self.rng.uniform(0.02, 0.06)), angle)], self._paint(True))

    def _stripes(self, x: float, y: float) -> None:
        angle, color = self.rng.uniform(0, 6.3), self._paint(True)
        pitch, count = self.rng.uniform(0.06, 0.16), int(self.rng.integers(2, 5))
        for i in range(count):
            offset = (i - (count - 1) / 2.0) * pitch
            dx, dy = -math.sin(angle) * offset, math.cos(angle) * offset
            half = (self.rng.uniform(0.05, 0.15), 0.25 * pitch)
            self._fill([self._box(x + dx, y + dy, half, angle)], color)

    def _car(self, x: float, y: float) -> None:
        angle, color = self.rng.uniform(0, 6.3), self._paint(self.rng.random() < 0.5)
        size = self.rng.uniform(0.1, 1.0)
        self._fill([self._box(x, y, (0.22 * size, 0.1 * size), angle)], color)
        glass = (float(self.rng.uniform(15, 60)),) * 3
        for at in (0.07, -0.14):
            middle = self._turned(np.array([[at * size, 0.0]]), x, y, angle)[0]
            self._fill([self._box(middle[0], middle[1], (0.03 * size, 0.08 * size), angle)], glass)

    def _person(self, x: float, y: float) -> None:
        angle = self.rng.uniform(0, 6.3)
        turn = np.linspace(0, 2 * math.pi, 16, endpoint=False)
        ring = np.column_stack([np.cos(turn), np.sin(turn)])
        shoulders = self._turned(ring * (0.22, 0.11), x, y, angle)
        self._fill([shoulders], self._paint(False))
        self._fill([self._turned(ring * 0.09, x, y, angle)], self._paint(self.rng.random() < 0.3))
        shadow = self._box(x + 0.3, y, (0.3, 0.1), 0.0)
        self._fill([shadow], (20.0, 20.0, 22.0))

    def _word(self, x: float, y: float) -> None:
        """A letter or two of OpenCV's fonts, none of them an H."""
        text = "".join(self.rng.choice(list(WORDS), int(self.rng.integers(1, 3))))
        glyph = np.zeros((96, 180), dtype=np.uint8)
        face = int(self.rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX]))
        cv2.putText(glyph, text, (20, 72), face, 2.0, (255.0,), int(self.rng.integers(4, 10)), cv2.LINE_AA)
        outlines, _ = cv2.findContours((glyph > 127).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        scale, angle = self.rng.uniform(0.15, 0.4) / 44.0, self.rng.uniform(0, 6.3)
        shapes = [
            self._turned((np.reshape(o, (-1, 2)).astype(float) - (60.0, 50.0)) * scale, x, y, angle) for o in outlines
        ]
        self._fill(shapes, self._paint(True))


def wall(rng: np.random.Generator, size: tuple[int, int], symbol_px: float) -> Image:
    """(height, width, 3) of courses of bricks, panes or rungs, turned at random, whose joints, brighter or darker than
    they are, make many an H about ``symbol_px`` high.
    """
    width, height = size
    joint = max(symbol_px * rng.uniform(0.08, 0.24), 1.0)
    course = symbol_px * rng.uniform(0.35, 1.1) + joint
    brick = symbol_px * rng.uniform(0.35, 1.6) + joint
    angle, lean = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.2, 0.2)
    across, down = np.arange(width) - width / 2.0, (np.arange(height) - height / 2.0)[:, None]
    x = math.cos(angle) * across + math.sin(angle) * down
    y = math.cos(angle + lean) * down - math.sin(angle + lean) * across
    row = np.floor(y / course)
    shift = row * brick * rng.choice([0.0, 0.5, 0.5, rng.uniform(0.0, 1.0)])
    column = np.floor((x + shift) / brick)
    every = int(rng.integers(1, 4)) if rng.random() < 0.3 else 1  # ladders: only some courses have uprights
    joints = ((y - row * course < joint) & (row % every == 0)) | (x + shift - column * brick < joint)
    shade = rng.normal(0.0, rng.uniform(2.0, 14.0), (64, 64))[row.astype(int) % 64, column.astype(int) % 64]
    low, high = rng.uniform(40.0, 130.0), rng.uniform(110.0, 235.0)
    face, seam = (low, high) if rng.random() < 0.7 else (high, low)
    grey = np.where(joints, seam, face + shade) + rng.normal(0.0, rng.uniform(2.0, 9.0), (height, width))
    blurred = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), rng.uniform(0.4, 1.4))
    tint = rng.uniform(0.85, 1.0, 3)
    result: Image = np.clip(np.asarray(blurred)[..., None] * tint, 0.0, 255.0).astype(np.float32)
    return result
