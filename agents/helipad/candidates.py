"""Where a symbol may be: peaks of a rotation-invariant response over a small picture.

The paper's circular filter (means on rings) and radial filter (means along rays, over all cyclic shifts) are the
angular harmonics of one template: the ring means are the harmonic 0, and a shift turns the phase of the others only.
So each harmonic is one pair of small kernels. The strongest tells the heading at every pixel, and twice its order must
agree with that: the sum of the three is about the normalised correlation with the symbol at its best heading.
Binarising that, rather than the intensity, gives blobs which light and texture hardly disturb; their peaks are the
candidates.
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

WINDOW = 0.75
"""half the side of the window, in heights"""
TURN = 64
HARMONIC, OVERTONE = 0.9, 1.1
"""weights of the strongest harmonic and of twice its order, where the ring means have 1"""
NOISE = 6.0
"""standard deviation in steps of 8 bits below which structure counts as noise"""
LEAST = 0.25
"""of the response"""
TINY = 1e-3
PICTURES = 8


class Room:
    """Where responses are computed. New pictures for each would cost more time than what is done in them."""

    def __init__(self) -> None:
        self._kept: Image = np.empty((PICTURES, 0), dtype=np.float32)

    def pictures(self, shape: tuple[int, ...]) -> list[Image]:
        """``PICTURES`` of ``shape`` (height, width), with anything in them."""
        size = math.prod(shape)
        if self._kept.shape[1] < size:
            self._kept = np.empty((PICTURES, size), dtype=np.float32)
        return [flat[:size].reshape(shape) for flat in self._kept]


class Kernels:
    """The harmonics of the mean of ``symbols``, ``scale`` pixels high, under a window that falls off to its edge."""

    def __init__(self, symbols: list[Symbol], scale: float, room: Room) -> None:
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
        for m in range(9):
            radial = np.interp(distance, rings, spectrum[:, m].real) + 1j * np.interp(
                distance, rings, spectrum[:, m].imag
            )
            wave = radial * np.exp(1j * m * angle) * (1.0 if m == 0 else 2.0)
            waves.append(window * (wave - (window * wave).sum()))
        power = [float((abs(w) ** 2 / window).sum()) / (1.0 if m == 0 else 2.0) for m, w in enumerate(waves)]
        strongest = max(range(1, 5), key=lambda m: power[m])
        orders = (0, strongest, 2 * strongest)
        whole = math.sqrt(sum(power[m] for m in orders))
        ring, ray, over = (waves[m] / whole for m in orders)
        parts = (ring.real, HARMONIC * ray.real, HARMONIC * ray.imag, OVERTONE * over.real, OVERTONE * over.imag)
        self._kernels: tuple[Image, ...] = tuple(np.ascontiguousarray(part, dtype=np.float32) for part in parts)
        self._room = room

    def response(self, level: Picture) -> Image:
        """(height, width): at each pixel, the correlation of the harmonics at the heading of the strongest, normalised.
        It is overwritten by the next one.
        """
        values, total, a, b, c, d, x, y = self._room.pictures(level.shape)
        np.copyto(values, level)  # filter2D is several times as fast from these as from 8 bits
        for kernel, into in zip(self._kernels, (total, a, b, c, d), strict=True):
            cv2.filter2D(values, cv2.CV_32F, kernel, dst=into)
        # (c, d) along the square of the direction of (a, b), which is (a a - b b, 2 a b) / (a a + b b).
        cv2.multiply(a, a, dst=x)
        cv2.multiply(b, b, dst=y)
        cv2.multiply(a, b, dst=a, scale=2.0)
        cv2.subtract(x, y, dst=b)
        cv2.add(x, y, dst=x)
        cv2.multiply(c, b, dst=c)
        cv2.multiply(d, a, dst=d)
        cv2.add(c, d, dst=c)
        cv2.sqrt(x, dst=y)
        cv2.add(total, y, dst=total)
        x += TINY
        cv2.divide(c, x, dst=c)
        cv2.add(total, c, dst=total)
        side = 2 * round(math.sqrt(6.0 * (self.box**2 - 1) / 12.0 + 0.25)) + 1  # about as wide as the window
        cv2.boxFilter(values, cv2.CV_32F, (side, side), dst=a)
        cv2.sqrBoxFilter(values, cv2.CV_32F, (side, side), dst=b)
        cv2.multiply(a, a, dst=a)
        cv2.subtract(b, a, dst=b)
        np.maximum(b, NOISE * NOISE, out=b)
        cv2.sqrt(b, dst=b)
        cv2.divide(total, b, dst=total)
        return total

    def candidates(self, level: Picture, most: int) -> Array:
        """(N, 2) pixels of ``level``, between pixels: the peaks, ``most`` at most, best first."""
        response = self.response(level)
        top = cv2.dilate(response, np.ones((3, 3), dtype=np.uint8))
        index = np.flatnonzero((response >= top) & (response > LEAST))
        strength = response.ravel()[index]
        if len(index) > most:
            best = np.argpartition(-strength, most)[:most]
            index, strength = index[best], strength[best]
        index = index[np.lexsort((index, -strength))]
        v, u = np.divmod(index, response.shape[1])
        return _between(response, u, v)


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
