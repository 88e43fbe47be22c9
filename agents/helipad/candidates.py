"""Where a symbol may be: blobs of a rotation-invariant response over a small picture.

The paper's circular filter (means on rings) and radial filter (means along rays, over all cyclic shifts) are the
angular harmonics of one template: the ring means are the harmonic 0, and a shift turns the phase of the others only.
So each harmonic is one pair of small kernels, and the sum of the magnitudes bounds the normalised correlation over all
headings at every pixel. Binarising that, rather than the intensity, gives blobs which light and texture hardly disturb;
their peaks are the only candidates.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad.channels import Picture
from agents.helipad.templates import Symbol

Array = NDArray[np.float64]
Image = NDArray[np.float32]

WINDOW = 0.8
"""half the side of the window, in heights"""
TURN = 64
HEADINGS = 24
"""of a whole turn"""
NOISE = 2.0
"""standard deviation in steps of 8 bits below which structure counts as noise"""
LEAST = 0.30
"""of the response"""
MOST_BLOBS = 400
"""that are compared with the whole symbol"""
MOST = 32


class Kernels:
    """The harmonics of the mean of ``symbols``, ``scale`` pixels high, under a window that falls off to its edge."""

    def __init__(self, symbols: list[Symbol], scale: float) -> None:
        self.box = max(round(WINDOW * scale), 2)
        # Two boxes one after the other make the window; correlation and spread are both weighed by it.
        tent = np.convolve(np.ones(self.box), np.ones(self.box)) / self.box**2
        window = tent[:, None] * tent
        axis = (np.arange(len(tent)) - len(tent) // 2) / scale
        x, y = np.meshgrid(axis, axis)
        distance, angle = np.hypot(x, y), np.arctan2(y, x)
        turn = np.arange(TURN) * 2.0 * math.pi / TURN
        rings = np.linspace(0.0, float(distance.max()), 24)
        places = rings[:, None] * np.cos(turn), rings[:, None] * np.sin(turn)
        around = np.mean([symbol.at(*places) for symbol in symbols], axis=0)
        spectrum = np.fft.fft(around, axis=1) / TURN  # of each ring
        waves = []
        for m in range(5):
            radial = np.interp(distance, rings, spectrum[:, m].real) + 1j * np.interp(
                distance, rings, spectrum[:, m].imag
            )
            wave = radial * np.exp(1j * m * angle) * (1.0 if m == 0 else 2.0)
            waves.append(window * (wave - (window * wave).sum()))
        power = [float((abs(w) ** 2 / window).sum()) / (1.0 if m == 0 else 2.0) for m, w in enumerate(waves)]
        strongest = max(range(1, 5), key=lambda m: power[m])
        whole = math.sqrt(power[0] + power[strongest])
        ring, ray = waves[0] / whole, waves[strongest] / whole
        self._ring: Image = ring.real.astype(np.float32)
        self._rays: tuple[Image, Image] = (ray.real.astype(np.float32), ray.imag.astype(np.float32))
        self._window: Image = window.ravel().astype(np.float32)
        self._full = self._templates(symbols, x, y)

    def _templates(self, symbols: list[Symbol], x: Array, y: Array) -> Image:
        """(pixels, M): the symbols at all headings, with their windows."""
        columns = []
        for symbol in symbols:
            for angle in np.arange(HEADINGS) * 2.0 * math.pi / HEADINGS:
                c, s = math.cos(angle), math.sin(angle)
                column = symbol.at(c * x + s * y, c * y - s * x).ravel()
                column = column - self._window @ column
                columns.append(self._window * column / math.sqrt(self._window @ column**2))
        return np.ascontiguousarray(np.array(columns, dtype=np.float32).T)

    def response(self, level: Picture) -> Image:
        """(height, width): at each pixel, the correlation of the two harmonics at their best heading, normalised."""
        values = level.astype(np.float32)
        total = cv2.filter2D(values, cv2.CV_32F, self._ring)
        a, b = (cv2.filter2D(values, cv2.CV_32F, part) for part in self._rays)
        total = cv2.add(total, cv2.magnitude(a, b))
        side = 2 * round(math.sqrt(6.0 * (self.box**2 - 1) / 12.0 + 0.25)) + 1  # about as wide as the window
        mean = cv2.boxFilter(level, cv2.CV_32F, (side, side))
        power = cv2.sqrBoxFilter(level, cv2.CV_32F, (side, side))
        spread = cv2.subtract(power, cv2.multiply(mean, mean))
        return np.asarray(total / np.sqrt(np.maximum(spread, NOISE * NOISE)), dtype=np.float32)

    def correlation(self, level: Picture, pixels: NDArray[np.intp]) -> Array:
        """(N,): of (N, 2) ``pixels``, the normalised correlation with the whole symbol at its best heading."""
        edge = round(math.sqrt(len(self._full)))
        before = edge // 2
        framed = cv2.copyMakeBorder(level, before, edge, before, edge, cv2.BORDER_REPLICATE)
        windows = np.lib.stride_tricks.sliding_window_view(framed, (edge, edge))
        patches = windows[pixels[:, 1], pixels[:, 0]].reshape(len(pixels), -1).astype(np.float32)
        patches -= (patches @ self._window)[:, None]
        spread = np.sqrt((patches * patches) @ self._window + NOISE * NOISE)
        return np.asarray((patches @ self._full).max(axis=1) / spread, dtype=float)

    def candidates(self, level: Picture, least: float) -> Array:
        """(N, 2) pixels of ``level``, between pixels, best first; ``least``: correlation."""
        response = self.response(level)
        top = cv2.dilate(response, np.ones((3, 3), dtype=np.uint8))
        index = np.flatnonzero((response >= top) & (response > LEAST))
        if len(index) > MOST_BLOBS:
            index = index[np.argpartition(-response.ravel()[index], MOST_BLOBS)[:MOST_BLOBS]]
        v, u = np.divmod(index, response.shape[1])
        if not len(index):
            return np.zeros((0, 2))
        quality = self.correlation(level, np.column_stack([u, v]))
        order = np.lexsort((index, -quality))[:MOST]
        order = order[quality[order] > least]
        return _between(response, u[order], v[order])


def _between(response: Image, u: NDArray[np.intp], v: NDArray[np.intp]) -> Array:
    """(N, 2): the tops of parabolas through the peaks of ``response`` and their neighbours."""
    result = np.column_stack([u, v]).astype(float)
    u = np.clip(u, 1, response.shape[1] - 2)
    v = np.clip(v, 1, response.shape[0] - 2)
    middle = response[v, u]
    sides = ((response[v, u - 1], response[v, u + 1]), (response[v - 1, u], response[v + 1, u]))
    for axis, (before, after) in enumerate(sides):
        bend = np.maximum(2.0 * middle - before - after, 1e-6)
        result[:, axis] += np.clip(0.5 * (after - before) / bend, -0.5, 0.5)
    return result
