"""What makes an H an H: two bars side by side, one across their middle, and nothing in the bays between them and beside
them. Looked at in upright patches in which bare ground is 0 and paint is 1, as :meth:`refine.Aligner.standard` has it.

A part of a pad may be hidden, so one of the four half bars may be missing. The limits leave out 1.4 % of the H that
the learned check is trained with, most of them in hard frames; they stand for shapes that it has not seen.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from agents.helipad.refine import REACH, SIDE

Image = NDArray[np.float32]

HALF_BARS = ((-0.36, -0.2, -0.45, -0.12), (0.2, 0.36, -0.45, -0.12), (-0.36, -0.2, 0.12, 0.45), (0.2, 0.36, 0.12, 0.45))
"""left, right, top and foot, in heights of the symbol; in all its proportions these are paint"""
ACROSS = ((-0.12, 0.12, -0.06, 0.06),)
BAYS = ((-0.1, 0.1, -0.5, -0.2), (-0.1, 0.1, 0.2, 0.5))
"""in all proportions these are bare, and so are:"""
BESIDE = ((-0.6, -0.46, -0.4, 0.4), (0.46, 0.6, -0.4, 0.4))
BAR, CROSSING, BARE = 0.03, 0.17, 0.45
"""least of the second weakest half bar and of the bar across them, above the bays; most beside them"""


@functools.cache
def _cells() -> Image:
    """(SIDE * SIDE, cells): what takes the mean of each."""
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2.0 * REACH - REACH
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    inside = [
        (x >= left) & (x <= right) & (y >= top) & (y <= foot)
        for left, right, top, foot in (*HALF_BARS, *ACROSS, *BAYS, *BESIDE)
    ]
    return np.column_stack([each / each.sum() for each in inside]).astype(np.float32)


def sound(patches: Image) -> NDArray[np.bool_]:
    """(N,): which of (N, SIDE * SIDE) patches are built as an H is."""
    means = patches @ _cells()
    bars = np.sort(means[:, :4], axis=1)
    bays = means[:, 5:7].max(axis=1)
    result: NDArray[np.bool_] = (
        (bars[:, 1] - bays >= BAR) & (means[:, 4] - bays >= CROSSING) & (means[:, 7:].max(axis=1) <= BARE)
    )
    return result
