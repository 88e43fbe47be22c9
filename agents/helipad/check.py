"""A small learned check of aligned patches: is this the built-in H?

Two hidden layers, of 96 and 32. ``check.npz`` holds their weights; tests/agents/helipad/train_check.py makes them from
rendered frames. Alone it is too sure of itself on pictures that it has not seen the like of, so the detector lets it
judge only what correlates with the symbol.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

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
        """Of :func:`scaled` patches: what each layer gives, (N, outputs); the last is the logarithm of the odds."""
        result: list[Image] = []
        for w, b in zip(self.weights, self.biases, strict=True):
            before = np.maximum(result[-1], 0.0) if result else inputs
            result.append(before @ w + b)
        return result

    def probability(self, patches: Image) -> Array:
        """(N,): of (N, M) aligned and normalised patches, how likely each is an H, 0 to 1."""
        logit = self.outputs(scaled(patches))[-1][:, 0].astype(float)
        result: Array = 1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0)))
        return result


def scaled(patches: Image) -> Image:
    """Patches with values about 1, none of which stands out so far that it decides alone."""
    result: Image = np.clip(patches * np.float32(np.sqrt(patches.shape[1])), -3.0, 3.0)
    return result
