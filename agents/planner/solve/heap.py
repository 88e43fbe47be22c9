"""A binary heap in two arrays, least key first: the open list of every search that is compiled."""

from __future__ import annotations

from agents.planner.model.problem import Floats, Ints
from agents.planner.solve.jit import jit


@jit
def push(keys: Floats, items: Ints, size: int, key: float, item: int) -> None:
    """Put into a binary heap of ``size``, least key first."""
    at = size
    while at > 0:
        above = (at - 1) // 2
        if keys[above] <= key:
            break
        keys[at], items[at] = keys[above], items[above]
        at = above
    keys[at], items[at] = key, item


@jit
def pop(keys: Floats, items: Ints, size: int) -> int:
    """Take the least out of a binary heap of ``size``."""
    taken, key, item = items[0], keys[size - 1], items[size - 1]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= size - 1:
            break
        if below + 1 < size - 1 and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[at], items[at] = keys[below], items[below]
        at = below
    keys[at], items[at] = key, item
    return int(taken)
