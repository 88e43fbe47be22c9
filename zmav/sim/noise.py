"""White noise for N vehicles whose numbers do not depend on how many there are.

Every vehicle draws from a generator of its own, in blocks: one more vehicle in a fleet leaves the noise of the others
as it was, and the draws cost next to nothing per tick.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array

BLOCK = 256  # draws of a vehicle at a time


class WhiteNoise:
    """``rows`` independent standard normal numbers a vehicle and draw.

    ``rng``: what the vehicles' generators are derived from; nothing else is taken from it.
    """

    def __init__(self, rng: np.random.Generator, rows: int, n: int) -> None:
        # First a child for this purpose, then one a vehicle: what was spawned before for others does not matter.
        self._generators = rng.spawn(1)[0].spawn(n)
        self._block: Array = np.zeros((BLOCK, rows, n))
        self._next = BLOCK

    def draw(self) -> Array:
        """The next (rows, N); a view that is good until the next draw."""
        if self._next == BLOCK:
            self._next = 0
            shape = self._block.shape[:2]
            for i, generator in enumerate(self._generators):
                self._block[:, :, i] = generator.standard_normal(shape)
        row: Array = self._block[self._next]
        self._next += 1
        return row
