"""A small learned check of aligned patches: is this the built-in H?

One hidden layer of 48. ``check.npz`` holds its weights; tests/agents/helipad/train_check.py makes them from rendered
frames. Alone it is too sure of itself on pictures that it has not seen the like of, so the detector lets it judge only
what correlates with the symbol.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

WEIGHTS = Path(__file__).with_name("check.npz")


class Check:
    """``first`` (M, hidden), ``bias`` (hidden,), ``second`` (hidden,), ``offset`` (1,)."""

    def __init__(self, first: Image, bias: Image, second: Image, offset: Image) -> None:
        self.first, self.bias, self.second, self.offset = (a.astype(np.float32) for a in (first, bias, second, offset))

    @classmethod
    def built_in(cls) -> Check:
        with np.load(WEIGHTS) as stored:
            return cls(*(stored[name] for name in ("first", "bias", "second", "offset")))

    def probability(self, patches: Image) -> Array:
        """(N,): of (N, M) aligned and normalised patches, how likely each is an H, 0 to 1."""
        hidden = np.maximum(scaled(patches) @ self.first + self.bias, 0.0)
        logit = (hidden @ self.second + self.offset).astype(float)
        result: Array = 1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0)))
        return result


def scaled(patches: Image) -> Image:
    """Patches with values about 1, none of which stands out so far that it decides alone."""
    result: Image = np.clip(patches * np.float32(np.sqrt(patches.shape[1])), -3.0, 3.0)
    return result
