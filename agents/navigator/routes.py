"""Routes as data: where to go, where to stop and for how long, which way to look. NED about the fleet's origin.

Made by :func:`shape` (``ev3``, ``square``, ``circle``, ``lemniscate``, ``steps``), :func:`through` waypoints, or
:func:`agents.navigator.files.load`. ``ev3`` is the navigation test of the MAS paper (its validation EV3): a level
square, followed by an upright rectangle that shares one side with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from agents.navigator.path import Array, Curve, Line, Piece, circle, lemniscate, placed, rounded, turned
from zmav.errors import BadInput
from zmav.rotation import wrap
from zmav.wire import Vector

FAR = 100_000.0
"""m from the fleet's origin at most"""
APART = 0.01
"""m between two waypoints at least"""
STRAIGHT, BACK = math.radians(0.5), math.radians(150.0)
"""of a turn: below it is none, above it is no corner that can be rounded"""
MOST_DWELL = 600.0


@dataclass(frozen=True)
class Stage:
    """A piece of a route that is flown without stopping."""

    piece: Piece
    speed: float = math.inf
    """m/s at most, beside what the flight allows"""
    dwell: float | None = None
    """s at rest at its end; None: its end is passed"""
    yaw: tuple[float, float] | None = None
    """rad at its beginning and at its end, turned in proportion to the way; None: as it is"""
    corner: float | None = None
    """m along it at which the way has a corner, or its stop"""


@dataclass(frozen=True)
class Route:
    """Stages that follow each other; ``begins``: m of a way to the route itself, which counts for nothing."""

    name: str
    stages: tuple[Stage, ...]
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
        """(K,) m at which there is a corner or a stop: the beginning and the end are two."""
        inside = [a + s.corner for a, s in zip(self.starts, self.stages, strict=False) if s.corner is not None]
        found = np.unique(np.round([self.begins, *inside, self.starts[-1]], 9))
        kept: Array = found[found >= self.begins - 1e-9]
        return kept

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """(N, 3) each at the distances ``s``: places, unit tangents, and their derivatives by the distance."""
        starts = self.starts
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(self.stages) - 1)
        found = np.empty((3, len(s), 3))
        for k in np.unique(which):
            mine = which == k
            piece = self.stages[k].piece
            found[:, mine] = piece.at(np.clip(s[mine] - starts[k], 0.0, piece.length))
        return found[0], found[1], found[2]

    def yaw(self, s: Array) -> Array | None:
        """(N,) rad; None: the route does not say."""
        ends = [stage.yaw for stage in self.stages]
        if any(each is None for each in ends):
            return None
        turns = [b + wrap(a - b) for b, a in (each for each in ends if each is not None)]
        starts = self.starts
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(self.stages) - 1)
        first = np.array([each[0] for each in ends if each is not None])[which]
        share = (s - starts[which]) / np.diff(starts)[which]
        found: Array = first + np.clip(share, 0.0, 1.0) * (np.array(turns)[which] - first)
        return found

    def looking(self, yaw: float) -> Route:
        """The same with this yaw where it says none."""
        stages = (stage if stage.yaw is not None else replace(stage, yaw=(yaw, yaw)) for stage in self.stages)
        return replace(self, stages=tuple(stages))

    def after(self, s: float) -> Route | None:
        """What is left of it behind the distance ``s``; None: nothing is."""
        starts = self.starts
        if s > starts[-1] - APART:
            return None
        k = int(np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(self.stages) - 1))
        done = s - float(starts[k])
        if self.stages[k].piece.length - done < APART and k + 1 < len(self.stages):
            k, done = k + 1, 0.0
        first = self.stages[k]
        if done > 0.0:
            corner = None if first.corner is None or first.corner < done else first.corner - done
            yaw = self.yaw(np.array([s]))
            turn = None if first.yaw is None or yaw is None else (float(yaw[0]), first.yaw[1])
            first = replace(first, piece=first.piece.after(done), corner=corner, yaw=turn)
        return Route(self.name, (first, *self.stages[k + 1 :]), max(0.0, self.begins - s))

    def reached_from(self, place: Vector, yaw: float, dwell: float = 0.0) -> Route:
        """The same with a straight way to it from ``place`` and ``dwell`` s at rest at its beginning."""
        to = self.at(np.zeros(1))[0][0]
        if math.dist(to, place) < APART:
            return self
        facing = self.stages[0].yaw
        way = Line(np.array(place), to)
        stage = Stage(way, dwell=dwell, yaw=(yaw, yaw if facing is None else facing[0]))
        return replace(self, stages=(stage, *self.stages), begins=self.begins + way.length)


@dataclass(frozen=True)
class Waypoint:
    """A place of a route, m NED."""

    pos: Vector
    speed: float = math.inf
    """m/s at most on the way to it"""
    dwell: float = 0.0
    """s at rest there"""
    yaw: float | None = None
    """rad, reached on the way to it"""


def through(name: str, waypoints: Sequence[Waypoint], rounding: float = 0.0) -> Route:
    """Straight from waypoint to waypoint, the first one being where it begins.

    It stops wherever the way has a corner, or is told to dwell; with ``rounding`` corners without a dwell are cut that
    many metres before and behind them (at most 0.45 of the shorter side). Raises :class:`~zmav.errors.BadInput`.
    """
    check("rounding", rounding, 0.0, 1000.0, "m")
    _check_waypoints(waypoints)
    places = [np.array(each.pos, dtype=float) for each in waypoints]
    sides = [float(np.linalg.norm(b - a)) for a, b in pairwise(places)]
    cuts = [0.0] * len(places)
    if rounding > 0.0:
        for k in range(1, len(places) - 1):
            if waypoints[k].dwell == 0.0 and STRAIGHT < _turn(*places[k - 1 : k + 2]) < BACK:
                cuts[k] = min(rounding, 0.45 * sides[k - 1], 0.45 * sides[k])
    stages = []
    for k, (one, two) in enumerate(pairwise(waypoints)):
        last = k + 2 == len(waypoints)
        direction = (places[k + 1] - places[k]) / sides[k]
        piece = Line(places[k] + cuts[k] * direction, places[k + 1] - cuts[k + 1] * direction)
        passed = not last and (cuts[k + 1] > 0.0 or (two.dwell == 0.0 and _turn(*places[k : k + 3]) <= STRAIGHT))
        yaw = None if one.yaw is None or two.yaw is None else (one.yaw, two.yaw)
        stages.append(Stage(piece, two.speed, None if passed else two.dwell, yaw, None if passed else piece.length))
        if cuts[k + 1] > 0.0:
            arc = rounded(places[k], places[k + 1], places[k + 2], cuts[k + 1])
            facing = None if two.yaw is None else (two.yaw, two.yaw)
            stages.append(Stage(arc, min(two.speed, waypoints[k + 2].speed), None, facing, 0.5 * arc.length))
    return Route(name, tuple(stages))


SIZES: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "ev3": {"side": (10.0, 0.5, 1000.0), "height": (5.0, 0.5, 500.0)},
    "square": {"side": (10.0, 0.5, 1000.0)},
    "circle": {"radius": (5.0, 0.5, 1000.0)},
    "lemniscate": {"length": (12.0, 1.0, 1000.0), "width": (6.0, 1.0, 1000.0)},
    "steps": {"step": (2.0, 0.1, 100.0)},
}
"""of each shape: its sizes in m, with default and bounds"""


def shape(
    name: str,
    centre: Vector = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    *,
    rounding: float = 0.0,
    dwell: float = 0.0,
    **sizes: float | None,
) -> Route:
    """A route by name about ``centre`` (m NED), turned clockwise by ``heading`` (rad). Sizes in m, by :data:`SIZES`:

    ``ev3`` (side, height): a level square about the centre, from its south-western corner (``heading`` 0) east about;
    then the rectangle that stands upwards on its first side, the southern one. ``square`` (side). ``circle`` (radius),
    clockwise from its northern end. ``lemniscate`` (length, width), from its middle. ``steps`` (step): from the centre
    to the north, the east and up, and back from each. ``dwell``: s at rest at each corner, three more at each step.
    Raises :class:`~zmav.errors.BadInput` naming the field, its value and what was expected.
    """
    if name not in SIZES:
        raise bad("route", name, ", ".join(SIZES))
    for field, value in zip(("north", "east", "down"), centre, strict=True):
        check(field, value, -FAR, FAR, "m")
    check("heading", heading, -4 * math.pi, 4 * math.pi, "rad")
    check("dwell", dwell, 0.0, MOST_DWELL, "s")
    check("rounding", rounding, 0.0, 1000.0, "m")
    given = _sizes(name, sizes)
    middle = np.array(centre, dtype=float)
    if name == "circle":
        curve = Curve(placed(circle(given["radius"]), middle, heading), 0.0, math.tau)
        return Route(name, (Stage(curve, dwell=0.0),))
    if name == "lemniscate":
        curve = Curve(placed(lemniscate(given["length"], given["width"]), middle, heading), 0.0, math.tau)
        return Route(name, (Stage(curve, dwell=0.0),))
    places = np.array(_corners(name, given)) @ turned(heading).T + middle
    rests = dwell + (3.0 if name == "steps" else 0.0)
    ends = (0, len(places) - 1)
    waypoints = [
        Waypoint((float(n), float(e), float(d)), dwell=0.0 if k in ends else rests)
        for k, (n, e, d) in enumerate(places)
    ]
    return through(name, waypoints, rounding)


def _corners(name: str, size: Mapping[str, float]) -> list[Vector]:
    if name == "steps":
        step = size["step"]
        out = [(step, 0.0, 0.0), (0.0, step, 0.0), (0.0, 0.0, -step)]
        return [(0.0, 0.0, 0.0), *(place for each in out for place in (each, (0.0, 0.0, 0.0)))]
    half = 0.5 * size["side"]
    a, b, c, d = (-half, -half, 0.0), (-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0)
    if name == "square":
        return [a, b, c, d, a]
    up = -size["height"]
    return [a, b, c, d, a, b, (-half, half, up), (-half, -half, up), a]


def _sizes(name: str, sizes: Mapping[str, float | None]) -> dict[str, float]:
    known = SIZES[name]
    given = {field: value for field, value in sizes.items() if value is not None}
    for field, value in given.items():
        if field not in known:
            raise bad(field, value, f"for the route {name} only {', '.join(known)}")
        check(field, value, *known[field][1:], "m")
    return {field: float(given.get(field, default)) for field, (default, _, _) in known.items()}


def _check_waypoints(waypoints: Sequence[Waypoint]) -> None:
    if not 2 <= len(waypoints) <= 1000:
        raise bad("waypoints", len(waypoints), "2 to 1000 of them")
    said = [each.yaw is not None for each in waypoints]
    for k, each in enumerate(waypoints):
        for axis, value in zip(("north", "east", "down"), each.pos, strict=True):
            check(f"waypoint[{k}].{axis}", value, -FAR, FAR, "m")
        if not each.speed > 0.0:
            raise bad(f"waypoint[{k}].speed", each.speed, "more than 0 m/s")
        check(f"waypoint[{k}].dwell", each.dwell, 0.0, MOST_DWELL, "s")
        if each.yaw is not None:
            check(f"waypoint[{k}].yaw", each.yaw, -math.tau, math.tau, "rad")
        if said[k] != said[0]:
            raise bad(f"waypoint[{k}].yaw", each.yaw, "a yaw for every waypoint, or for none")
        if k and math.dist(each.pos, waypoints[k - 1].pos) < APART:
            raise bad(f"waypoint[{k}].pos", list(each.pos), "another place than the one before: give that one a dwell")


def _turn(a: Array, b: Array, c: Array) -> float:
    """rad by which the way turns at ``b``."""
    one, two = b - a, c - b
    return math.atan2(float(np.linalg.norm(np.cross(one, two))), float(one @ two))


def check(field: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise :class:`~zmav.errors.BadInput` for what is not between them, or not finite."""
    if not low <= value <= high:
        raise bad(field, value, f"{low:g} to {high:g} {unit}")


def bad(field: str, value: object, expected: str) -> BadInput:
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return BadInput(f"{field} = {shown}; expected {expected}", field=field, value=value, expected=expected)
