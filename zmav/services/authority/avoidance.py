"""Whether vehicles are about to meet, and the way out: pure geometry in metres NED, seconds from now.

A sampled velocity obstacle (Fiorini and Shiller 1998; van den Berg et al. 2008) over what each vehicle says it will fly
next, instead of straight lines. It is the last resort of a vehicle that no planner looks after: it keeps two vehicles
apart for a moment, and brings nobody to a goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from zmav import geo
from zmav.wire import Vector

STEP = 0.25
STEPS = 10
"""a track is a place every STEP seconds, from now on"""
CLEARER = 1.3
"""times the distance that must be kept: what is tried to be kept once moving aside, and what ends it"""
LEVEL = 0.3
"""m of height by which one of two is the higher one"""

Track = Sequence[Vector]


class Other(NamedTuple):
    """A neighbour: where it will be, how far its centre is to stay away, and which of us goes up if we are level."""

    name: str
    track: Track
    distance: float
    """m in the metric of :func:`least`"""


class Motion(NamedTuple):
    """What the vehicle can do: m/s and m/s²; ``flat``: over the ground only."""

    speed: float
    accel: float
    climb: float
    descend: float
    flat: bool = False


def least(a: Track, b: Track, downwash: float) -> tuple[float, float]:
    """The least distance of two tracks and when it is; a metre of height counts as ``1 / downwash`` metres.

    Between the steps both go straight on, so that nothing slips through.
    """
    best, when = math.inf, 0.0
    for k in range(min(len(a), len(b)) - 1):
        p, q = _apart(a[k], b[k], downwash), _apart(a[k + 1], b[k + 1], downwash)
        d = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
        square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        share = -(p[0] * d[0] + p[1] * d[1] + p[2] * d[2]) / square if square else 0.0
        share = min(max(share, 0.0), 1.0)
        away = math.hypot(p[0] + share * d[0], p[1] + share * d[1], p[2] + share * d[2])
        if away < best:
            best, when = away, (k + share) * STEP
    return best, when


def meets(own: Track, other: Other, downwash: float, times: float = 1.0) -> bool:
    """They come nearer than ``times`` their distance, and are not just going apart."""
    away, when = least(own, other.track, downwash)
    return away < times * other.distance and when > 0.0


def ramp(pos: Vector, vel: Vector, wanted: Vector, accel: float) -> list[Vector]:
    """The track of a vehicle that changes its velocity to ``wanted`` at ``accel`` m/s²."""
    track, now = [pos], vel
    for _ in range(STEPS):
        change = math.dist(now, wanted)
        share = min(1.0, accel * STEP / change) if change else 1.0
        after = geo.between(now, wanted, share)
        pos = geo.plus(pos, geo.between(now, after, 0.5), STEP)
        now = after
        track.append(pos)
    return track


def straight(pos: Vector, vel: Vector) -> list[Vector]:
    """The track of a vehicle that goes on as it does."""
    return [geo.plus(pos, vel, k * STEP) for k in range(STEPS + 1)]


def escape(
    name: str,
    pos: Vector,
    vel: Vector,
    wanted: Vector,
    others: Sequence[Other],
    motion: Motion,
    downwash: float,
    allowed: Callable[[Vector], bool],
) -> Vector:
    """The velocity that keeps clear of all others, or else farthest from them, and of those the nearest to ``wanted``.

    So that two never choose the same way out: of those that meet level the one whose name comes later goes up, and
    where left and right are as good as each other everybody turns right.
    """
    best, least_cost = (0.0, 0.0, 0.0), math.inf
    for candidate, left in _candidates(vel, wanted, motion):
        if not allowed(candidate):
            continue
        track = ramp(pos, vel, candidate, motion.accel)
        lack = max(1.0 - least(track, o.track, downwash)[0] / (CLEARER * o.distance) for o in others)
        wrong = sum(_wrong_way(name, pos, candidate[2], other) for other in others)
        cost = 100.0 * max(lack, 0.0) + 5.0 * (wrong + left) + math.dist(candidate, wanted)
        if cost < least_cost:
            best, least_cost = candidate, cost
    return best


def _candidates(vel: Vector, wanted: Vector, motion: Motion) -> Iterator[tuple[Vector, bool]]:
    """Level speeds ahead, aside and none, each with every climb rate, and whether it is a turn to the left; the wanted
    one first.
    """
    yield wanted, False
    course = math.atan2(wanted[1], wanted[0]) if math.hypot(*wanted[:2]) > 0.2 else math.atan2(vel[1], vel[0])
    speed = max(math.hypot(*wanted[:2]), 0.5 * motion.speed)
    level = [(0.0, 0.0, False)]
    for turn in (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0):
        angle = course + math.radians(turn)
        level.append((speed * math.cos(angle), speed * math.sin(angle), turn < 0.0))
    for north, east, left in level:
        for down in (0.0,) if motion.flat else (0.0, -motion.climb, motion.descend):
            yield (north, east, down), left


def _wrong_way(name: str, pos: Vector, down: float, other: Other) -> bool:
    """It goes up where the other does, or down where the other does."""
    above = other.track[0][2] - pos[2]
    upper = above > 0.0 if abs(above) > LEVEL else name > other.name
    return down > 0.0 if upper else down < 0.0


def _apart(p: Vector, q: Vector, downwash: float) -> Vector:
    return p[0] - q[0], p[1] - q[1], (p[2] - q[2]) / downwash
