"""One search of one scalar picture at one supposed distance: candidates, polar match, alignment."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.helipad import polar
from agents.helipad.candidates import Kernels, Room
from agents.helipad.channels import Picture, Pyramid
from agents.helipad.geometry import View
from agents.helipad.refine import Aligner, turned
from agents.helipad.templates import Symbol, letter_h

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FINE_PX = 13.0
"""height of a symbol in the picture that they are looked at in"""
LEAST_MATCH = 0.4
"""correlation of the polar patch"""
LARGEST_PX = 400_000
"""of the picture that candidates are sought in: a view toward the horizon is cut"""
ABOUT = 0.3 * np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
"""heights from where a symbol may be, that are matched where it is told where"""
ALSO_ALIGNED = 3
"""of these"""
ALIGN_STEPS = 4
SCALES = (0.88, 1.0, 1.14)
"""of the supposed height that the polar match tries; alignment goes somewhat beyond"""
FARTHEST_SCALE = 1.35


class Effort(NamedTuple):
    """How closely candidates are sought."""

    coarse_px: float
    """height of a symbol in the picture that they are sought in; the work grows with its square"""
    most: int
    """candidates"""
    aligned: int
    """of them"""
    sure: float
    """logarithm of the odds that the learned check must give: more, the more is looked at"""


KNOWN = Effort(6.5, 120, 12, 1.9)
YELLOW = Effort(5.0, 60, 12, 1.9)
"""the same in yellow, which shows little else"""
UNKNOWN = Effort(5.0, 60, 6, 3.7)
"""one of many heights that are tried"""
ASTRAY = Effort(5.0, 40, 8, 3.7)
"""the same where another height was given, and nothing found there"""


class Proposals(NamedTuple):
    """What may be symbols, aligned: N of them."""

    middles: Array
    """(N, 2) pixels of the whole frame"""
    affines: Array
    """(N, 2, 2) from the symbol's axes, in its heights, to pixels"""
    patches: Image
    """(N, M) upright, ground at 0 and paint at 1"""
    correlation: Array
    """(N,)"""


@functools.cache
def _made() -> tuple[list[Symbol], polar.Bank, Aligner]:
    """What all detectors share, for nothing of it changes."""
    symbols = letter_h()
    return symbols, polar.Bank(symbols, SCALES), Aligner(symbols)


class Searcher:
    """The stages made ready for the letter H in its proportions."""

    def __init__(self) -> None:
        self.symbols, self._bank, self.aligner = _made()
        self._kernels: dict[float, Kernels] = {}
        self._room = Room()
        self._grid = polar.grid()

    def proposals(self, pyramid: Pyramid, view: View, effort: Effort = KNOWN, also: Array | None = None) -> Proposals:
        """What in ``pyramid`` may be a symbol on the plane of ``view``. ``also``: (N, 2) pixels about which one may be,
        whatever else there is.
        """
        origin = pyramid.origin
        middles = self._candidates(pyramid, view, effort)
        count = len(middles)
        also = np.zeros((0, 2)) if also is None else also[self._seen(pyramid, view, also)]
        if len(also):
            about = np.einsum("nij,kj->nki", view.affine(also), ABOUT) + also[:, None]
            middles = np.vstack([middles, about.reshape(-1, 2)])
        if not len(middles):
            return self._none()
        fine, to_fine = pyramid.shrunk(FINE_PX / view.scale)
        affines = view.affine(middles) * to_fine[:, None]
        middles = (middles - origin + 0.5) * to_fine - 0.5
        patches = polar.normalised(polar.sample(fine, middles, affines, *self._grid), self._bank.weight)
        match, symbols, scales, angles = self._bank.match(patches)
        best = np.argsort(-match[:count], kind="stable")[: effort.aligned]
        best = best[match[best] > LEAST_MATCH]
        if len(match) > count:
            best = np.append(best, count + np.argsort(-match[count:], kind="stable")[: len(also) * ALSO_ALIGNED])
        if not len(best):
            return self._none()
        start = affines[best]
        placed, affines = self.aligner.align(
            fine, symbols[best], middles[best], start @ turned(angles[best], scales[best]), ALIGN_STEPS
        )
        grown = np.sqrt(np.abs(np.linalg.det(affines) / np.linalg.det(start)))
        near = np.linalg.norm(placed - middles[best], axis=1) < 0.6 * np.sqrt(np.abs(np.linalg.det(start)))
        sound = (grown < FARTHEST_SCALE) & (grown > 1.0 / FARTHEST_SCALE) & near
        return self._judged(fine, placed[sound], affines[sound], origin, to_fine)

    def _candidates(self, pyramid: Pyramid, view: View, effort: Effort) -> Array:
        """(N, 2) pixels of the frame; sought in a level picture, where the symbol has one size everywhere."""
        scale = min(effort.coarse_px, view.scale)
        width, height = pyramid.size
        corners = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]) + pyramid.origin
        if not view.in_front(corners).all():
            return np.zeros((0, 2))
        corners = view.flat(corners) * scale
        low = np.floor(corners.min(axis=0))
        size = np.ceil(corners.max(axis=0)) - low + 1.0
        size *= min(1.0, math.sqrt(LARGEST_PX / (size[0] * size[1])))
        from_level = np.array([[1.0 / scale, 0.0, low[0] / scale], [0.0, 1.0 / scale, low[1] / scale], [0.0, 0.0, 1.0]])
        matrix = view.matrix @ from_level
        level = pyramid.warped(matrix, (max(int(size[0]), 8), max(int(size[1]), 8)), scale / view.scale)
        found = self._kernels_for(scale).candidates(level, effort.most)
        pixels = np.column_stack([found, np.ones(len(found))]) @ matrix.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        return np.asarray(pixels[self._seen(pyramid, view, pixels)], dtype=float)

    @staticmethod
    def _seen(pyramid: Pyramid, view: View, pixels: Array) -> NDArray[np.bool_]:
        """(N,): which of (N, 2) pixels are in the picture and see the plane."""
        inside = np.all((pixels >= pyramid.origin) & (pixels < pyramid.origin + np.array(pyramid.size)), axis=1)
        return np.asarray(inside & view.in_front(pixels), dtype=bool)

    def _judged(self, fine: Picture, middles: Array, affines: Array, origin: Array, to_fine: Array) -> Proposals:
        if not len(middles):
            return self._none()
        raw = self.aligner.patches(fine, middles, affines)
        correlation = self.aligner.correlation(raw)
        symbols = correlation.argmax(axis=1)
        return Proposals(
            (middles + 0.5) / to_fine - 0.5 + origin,
            affines / to_fine[:, None],
            self.aligner.standard(raw, symbols),
            correlation.max(axis=1),
        )

    def _kernels_for(self, scale: float) -> Kernels:
        """Those for symbols about that many pixels high; made once for each quarter of a pixel."""
        key = max(round(4.0 * scale), 10) / 4.0
        if key not in self._kernels:
            self._kernels[key] = Kernels(self.symbols, key, self._room)
        return self._kernels[key]

    def _none(self) -> Proposals:
        none = np.zeros(0)
        patches = np.zeros((0, len(self.aligner.x)), dtype=np.float32)
        return Proposals(none.reshape(0, 2), none.reshape(0, 2, 2), patches, none)
