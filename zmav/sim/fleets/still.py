"""Who stands still costs little: a tick that would change nothing is not made."""

from __future__ import annotations

import numpy as np


class Standstill:
    """Sees that ticks change nothing: all that they go by, state and inputs to the last bit, is as it was before each
    of the last ``steps``, a whole round of the slowest loop. One more would change nothing either.
    """

    def __init__(self, steps: int = 1) -> None:
        self.steps = steps
        self._seen: list[object] = []
        self._since = 0

    def holds(self, *parts: object) -> bool:
        """A yes makes the next tick needless. ``parts``: arrays and numbers, each time the same ones."""
        seen = [part.tobytes() if isinstance(part, np.ndarray) else part for part in parts]
        self._since = self._since + 1 if seen == self._seen else 0
        self._seen = seen
        return self._since >= self.steps


def arrays_of(*owners: object) -> list[object]:
    """The arrays among the attributes of objects whose whole state is in arrays."""
    return [value for owner in owners for value in vars(owner).values() if isinstance(value, np.ndarray)]
