"""A small learned check of aligned patches: is this the built-in H?

Three networks of two hidden layers each, of 96 and 32; the mean of their odds counts, as they err in different places.
``check.npz`` holds them side by side, as one; tests/agents/helipad/train_check.py makes it from rendered frames and
photographs. Alone it is too sure of itself on pictures that it has not seen the like of, so the detector lets it judge
only what correlates with the symbol.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.helipad import structure

Array = NDArray[np.float64]
Image = NDArray[np.float32]

NEVER = -30.0
"""logarithm of the odds"""
WEIGHTS = Path(__file__).with_name("check.npz")


class LearnedCheck:
    """``weights``: of each layer (inputs, outputs), the last has one output; ``biases``: of each layer (outputs,)."""

    def __init__(self, weights: list[Image], biases: list[Image]) -> None:
        self.weights = [w.astype(np.float32) for w in weights]
        self.biases = [b.astype(np.float32) for b in biases]

    @classmethod
    @functools.cache
    def built_in(cls) -> LearnedCheck:
        with np.load(WEIGHTS) as stored:
            layers = range(len(stored.files) // 2)
            return cls([stored[f"weights{i}"] for i in layers], [stored[f"biases{i}"] for i in layers])

    def outputs(self, inputs: Image) -> list[Image]:
        """Of :func:`features`: what each layer gives, (N, outputs); the last is the logarithm of the odds."""
        result: list[Image] = []
        for w, b in zip(self.weights, self.biases, strict=True):
            before = np.maximum(result[-1], 0.0) if result else inputs
            result.append(before @ w + b)
        return result

    def odds(self, patches: Image) -> Array:
        """(N,): of (N, M) aligned patches, ground at 0 and paint at 1: the logarithm of the odds that each is an H;
        NEVER where it is not built as one.
        """
        learned = self.outputs(features(patches))[-1][:, 0].astype(float)
        result: Array = np.where(structure.sound(patches), learned, NEVER)
        return result


def features(patches: Image) -> Image:
    """(N, M): of patches, what half a turn and both mirror images leave as it is. An H is its own mirror image either
    way, so the first quarter, the mean of the four, holds all of it; the magnitudes of the three differences hold what
    is against that symmetry.
    """
    side = math.isqrt(patches.shape[1])
    half = side // 2
    values = patches.reshape(-1, side, side)
    upper, lower = values[:, :half], values[:, : half - 1 : -1]
    across, along = upper + lower, upper - lower
    parts = [
        sign(rows[:, :, :half], rows[:, :, : half - 1 : -1])
        for rows in (across, along)
        for sign in (np.add, np.subtract)
    ]
    result: Image = np.concatenate([part.reshape(-1, half * half) for part in parts], axis=1) * np.float32(0.25)
    return np.abs(result, out=result, where=np.arange(side * side) >= half * half)
