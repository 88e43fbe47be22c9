"""How the routers of a simulated fleet are linked: who connects to whom."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

Topology = Literal["line", "star", "grid", "tree"]
FANOUT = 4
"""branches of a node of ``tree``"""


def _line(i: int, count: int) -> list[int]:
    return [i - 1]


def _star(i: int, count: int) -> list[int]:
    return [0]


def _tree(i: int, count: int) -> list[int]:
    return [(i - 1) // FANOUT]


def _grid(i: int, count: int) -> list[int]:
    width = math.isqrt(count - 1) + 1
    left, above = i - 1 if i % width else None, i - width if i >= width else None
    return [j for j in (left, above) if j is not None]


_KINDS: dict[Topology, Callable[[int, int], list[int]]] = {
    "line": _line,
    "star": _star,
    "grid": _grid,
    "tree": _tree,
}
TOPOLOGIES = tuple(_KINDS)


def links(kind: Topology, count: int) -> list[list[int]]:
    """For each of ``count`` routers those it connects to; they stand before it, and the first connects to none."""
    return [[], *(_KINDS[kind](i, count) for i in range(1, count))]
