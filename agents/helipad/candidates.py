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

REACH = 0.68
"""radius of the kernels, in heights of the symbol"""
HARMONICS = 2
"""beside 0: the strongest ones"""
TURN = 64
NOISE = 2.0
"""standard deviation in steps of 8 bits below which structure counts as noise"""
LEAST = 0.50
"""of the bounded correlation"""


class Kernels:
    """The harmonics of ``symbol`` where it is ``scale`` pixels high."""

    def __init__(self, symbol: Symbol, scale: float) -> None:
        radius = max(math.ceil(REACH * scale - 0.25), 2)
        self.side = 2 * radius + 1
        axis = np.arange(-radius, radius + 1, dtype=float) / scale
        x, y = np.meshgrid(axis, axis)
        distance = np.hypot(x, y)
        angle = np.arctan2(y, x)
        inside = distance <= REACH + 0.25 / scale
        turn = np.arange(TURN) * 2.0 * math.pi / TURN
        rings = np.linspace(0.0, REACH + 0.5 / scale, 24)
        around = symbol.at(rings[:, None] * np.cos(turn), rings[:, None] * np.sin(turn))
        spectrum = np.fft.fft(around, axis=1) / TURN  # of each ring
        waves = []
        for m in range(7):
            radial = np.interp(distance, rings, spectrum[:, m].real) + 1j * np.interp(distance, rings, spectrum[:, m].imag)
            wave = np.where(inside, radial * np.exp(1j * m * angle) * (1.0 if m == 0 else 2.0), 0.0)
            if m == 0:
                wave = np.where(inside, wave - wave[inside].mean(), 0.0)
            waves.append(wave)
        strength = [float((np.abs(w) ** 2).sum()) for w in waves]
        order = sorted(range(1, 7), key=lambda m: -strength[m])[:HARMONICS]
        whole = math.sqrt(sum((waves[m].real ** 2).sum() for m in [0, *order]) * 1.0)
        self.ring: Image = (waves[0].real / whole).astype(np.float32)
        self.rays: list[tuple[Image, Image]] = [
            ((waves[m].real / whole).astype(np.float32), (waves[m].imag / whole).astype(np.float32)) for m in order
        ]
        self.count = int(inside.sum())

    def response(self, picture: Picture) -> Image:
        """(height, width): at each pixel, the bound of the normalised correlation over all headings."""
        values = picture.astype(np.float32)
        total = cv2.filter2D(values, cv2.CV_32F, self.ring)
        for cosine, sine in self.rays:
            total += cv2.magnitude(
                cv2.filter2D(values, cv2.CV_32F, cosine), cv2.filter2D(values, cv2.CV_32F, sine)
            )
        window = (self.side, self.side)
        mean = cv2.boxFilter(values, cv2.CV_32F, window)
        power = cv2.boxFilter(cv2.multiply(values, values), cv2.CV_32F, window)
        spread = cv2.sqrt(cv2.max(power - mean * mean, 0.0) + NOISE * NOISE)
        return np.asarray(total / (spread * math.sqrt(self.count)), dtype=np.float32)


def peaks(response: Image, most: int) -> tuple[Array, Array]:
    """(N, 2) pixels of the ``most`` highest blobs of ``response``, best first, between pixels, and their heights (N,)."""
    top = cv2.dilate(response, np.ones((3, 3), dtype=np.uint8))
    v, u = np.nonzero((response >= top) & (response > LEAST))
    heights = response[v, u]
    if len(heights) > most:
        kept = np.argpartition(-heights, most)[:most]
        v, u, heights = v[kept], u[kept], heights[kept]
    order = np.lexsort((u, v, -heights))
    v, u, heights = v[order], u[order], heights[order]
    result = np.column_stack([u, v]).astype(float)
    inner = (u > 0) & (v > 0) & (u < response.shape[1] - 1) & (v < response.shape[0] - 1)
    ui, vi = u[inner], v[inner]
    middle = response[vi, ui]
    for axis, (before, after) in enumerate(
        ((response[vi, ui - 1], response[vi, ui + 1]), (response[vi - 1, ui], response[vi + 1, ui]))
    ):
        bend = np.maximum(2.0 * middle - before - after, 1e-6)
        result[inner, axis] += np.clip(0.5 * (after - before) / bend, -0.5, 0.5)
    return result, heights.astype(float)
