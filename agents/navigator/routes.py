"""Routes as data: lines and curves that follow each other, each flown to rest. NED about the fleet's origin.

``ev3`` is the navigation test of the MAS paper (its validation EV3): a level square, followed by an upright rectangle
that shares one side with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from agents.navigator.path import Array, Curve, Piece, StraightPiece, lissajous, turned
from zmav.errors import BadInput
from zmav.wire import Vector

FAR = 100_000.0
"""m from the fleet's origin at most"""
APART = 0.01
"""m to a route's beginning from which a way to it is flown"""
MOST_DWELL = 600.0


@dataclass(frozen=True)
class RoutePiece:
    """A piece of a route, and the s at rest at its end."""

    piece: Piece
    dwell: float = 0.0


@dataclass(frozen=True)
class Route:
    """Stages that follow each other; ``begins``: m of a way to the route itself, which counts for nothing."""

    name: str
    stages: tuple[RoutePiece, ...]
    begins: float = 0.0

    @property
    def starts(self) -> Array:
        """(K + 1,) m at which each stage begins, and the end."""
        return np.concatenate(([0.0], np.cumsum([stage.piece.length for stage in self.stages])))

    @property
    def length(self) -> float:
        """m, without the way to it"""
        return float(self.starts[-1]) - self.begins

    @property
    def corners(self) -> Array:
        """(K,) m at which it stops: the beginning and the end are two."""
        starts = self.starts
        kept: Array = starts[starts >= self.begins - 1e-9]
        return kept

    def stage_at(self, s: Array) -> Array:
        """(N,) the index of the stage at the distances ``s``."""
        found: Array = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.stages) - 1)
        return found

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """(N, 3) each at the distances ``s``: places, unit tangents, and their derivatives by the distance."""
        starts, which = self.starts, self.stage_at(s)
        found = np.empty((3, len(s), 3))
        for k in np.unique(which):
            mine = which == k
            piece = self.stages[k].piece
            found[:, mine] = piece.at(np.clip(s[mine] - starts[k], 0.0, piece.length))
        return found[0], found[1], found[2]

    def reached_from(self, place: Vector, dwell: float = 0.0) -> Route:
        """The same with a straight way to it from ``place`` and ``dwell`` s at rest at its beginning."""
        to = self.at(np.zeros(1))[0][0]
        if math.dist(to, place) < APART:
            return self
        way = StraightPiece(np.array(place), to)
        return replace(self, stages=(RoutePiece(way, dwell), *self.stages), begins=self.begins + way.length)


SIZES: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "ev3": {"side": (10.0, 0.5, 1000.0), "height": (5.0, 0.5, 500.0)},
    "square": {"side": (10.0, 0.5, 1000.0)},
    "circle": {"radius": (5.0, 0.5, 1000.0)},
    "lemniscate": {"length": (12.0, 1.0, 1000.0), "width": (6.0, 1.0, 1000.0)},
}
"""of each shape: its sizes in m, with default and bounds"""


def shape(
    name: str, centre: Vector = (0.0, 0.0, 0.0), heading: float = 0.0, *, dwell: float = 0.0, **sizes: float | None
) -> Route:
    """A route by name about ``centre`` (m NED), turned clockwise by ``heading`` (rad). Sizes in m, by :data:`SIZES`:

    ``ev3`` (side, height): a level square about the centre, from its south-western corner (``heading`` 0) east about;
    then the rectangle that stands upwards on its first side, the southern one. ``square`` (side). ``circle`` (radius),
    clockwise from its northern end. ``lemniscate`` (length, width), from its middle. ``dwell``: s at rest at each
    corner. Raises :class:`~zmav.errors.BadInput` naming the field, its value and what was expected.
    """
    if name not in SIZES:
        raise BadInput.wrong("route", name, ", ".join(SIZES))
    for field, value in zip(("north", "east", "down"), centre, strict=True):
        check(field, value, -FAR, FAR, "m")
    check("heading", heading, -4 * math.pi, 4 * math.pi, "rad")
    check("dwell", dwell, 0.0, MOST_DWELL, "s")
    given = _sizes(name, sizes)
    middle = np.array(centre, dtype=float)
    figure = None
    if name == "circle":
        figure = lissajous(given["radius"], given["radius"], 1.0, 0.5 * math.pi, middle, heading)
    elif name == "lemniscate":  # Gerono's
        figure = lissajous(0.5 * given["length"], 0.5 * given["width"], 2.0, 0.0, middle, heading)
    if figure is not None:
        return Route(name, (RoutePiece(Curve(figure, 0.0, math.tau)),))
    sides = [StraightPiece(one, two) for one, two in pairwise(np.array(_corners(**given)) @ turned(heading).T + middle)]
    return Route(name, (*(RoutePiece(side, dwell) for side in sides[:-1]), RoutePiece(sides[-1])))


def _corners(side: float, height: float = 0.0) -> list[Vector]:
    """Of a level square, and of the rectangle on its first side where that has a height."""
    half = 0.5 * side
    a, b, c, d = (-half, -half, 0.0), (-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0)
    upright = [b, (-half, half, -height), (-half, -half, -height), a] if height else []
    return [a, b, c, d, a, *upright]


def _sizes(name: str, sizes: Mapping[str, float | None]) -> dict[str, float]:
    known = SIZES[name]
    given = {field: value for field, value in sizes.items() if value is not None}
    for field, value in given.items():
        if field not in known:
            raise BadInput.wrong(field, value, f"for the route {name} only {', '.join(known)}")
        check(field, value, *known[field][1:], "m")
    return {field: float(given.get(field, default)) for field, (default, _, _) in known.items()}


def check(field: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise :class:`~zmav.errors.BadInput` for what is not between them, or not finite."""
    if not low <= value <= high:
        raise BadInput.wrong(field, value, f"{low:g} to {high:g} {unit}")
