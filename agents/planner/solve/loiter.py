"""Where planes stay: circles, and heights at which no two planes on their way can meet whenever each is where.

A plane never rests, so that no committed trajectory fits it. It is sent to a circle (``goto`` with a radius: ArduPilot
and PX4 both fly that by themselves, for ever), and what keeps planes apart needs no clock: two planes whose circles and
ways come near each other over the ground have heights of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import shapely

from zmav.errors import BadInput
from zmav.wire import Vector
from zmav.wire.swarm import Body

STEADY = 5.0
"""m by which a plane may be off its height"""
ASIDE = 30.0
"""m by which it may be off its way and its circle, over the ground (wind, overshoot)"""
GRAVITY = 9.81
BANK = math.radians(35.0)
"""a circle's bank at most, where the body says nothing of its turns"""


@dataclass(frozen=True)
class Circling:
    """A plane that flies, and where it is wanted; m NED about the fleet's origin."""

    vehicle: str
    body: Body
    pos_ned: Vector
    """now: it circles here, or goes straight from here"""
    goal_ned: Vector
    """the middle of the circle that is wanted; its height is as near to this as the others leave room"""


@dataclass(frozen=True)
class LoiterCircle:
    """A circle of one plane's own."""

    vehicle: str
    centre_ned: Vector
    radius: float
    """m; clockwise seen from above"""
    speed: float
    """m/s"""
    first: tuple[str, ...] = ()
    """planes that must have reached their heights before this one leaves its own"""


def loiter_radius(body: Body) -> float:
    """m of a circle that the plane flies at ease, at the speed of :func:`loiter_speed`."""
    speed = loiter_speed(body)
    own = speed * speed / (0.6 * body.accel) if body.accel > 0.0 else speed * speed / (GRAVITY * math.tan(BANK))
    return max(own, 1.2 * body.turn_radius)


def loiter_speed(body: Body) -> float:
    """m/s: with some room above the slowest it can fly."""
    return min(body.speed, 1.25 * body.min_speed) if body.min_speed > 0.0 else body.speed


def loiter_slots(planes: Sequence[Circling], floor: float, ceiling: float, downwash: float = 1.0) -> list[LoiterCircle]:
    """A circle for each plane, and the order in which they change their heights.

    Planes keep their order in height, so that nobody must pass another; where two may come near each other over the
    ground their heights differ by the sum of their radii (times ``downwash``) and what both may be off. A plane first
    reaches its new height where it circles, once those in ``first`` have reached theirs, and then goes to its circle.
    From then on until it is sent elsewhere, and on the way, it needs no clock to meet nobody.

    ``floor``, ``ceiling``: m above the fleet's origin. Raises :class:`BadInput` where there is no room for all.
    """
    order = sorted(range(len(planes)), key=lambda i: (-planes[i].pos_ned[2], planes[i].vehicle))
    near = {(i, j): _near(planes[i], planes[j]) for i in order for j in order if i != j}
    gap = {(i, j): _gap(planes[i].body, planes[j].body, downwash) for i, j in near}
    heights: dict[int, float] = {}
    for i in order:  # from the lowest up: as wished, or as low as those below leave it
        least = [heights[j] + gap[i, j] for j in heights if near[i, j]]
        heights[i] = max([floor, -planes[i].goal_ned[2], *least])
    settled: dict[int, float] = {}
    for i in reversed(order):  # and down again where the sky ends
        most = [settled[j] - gap[i, j] for j in settled if near[i, j]]
        settled[i] = min([ceiling, heights[i], *most])
        if settled[i] < floor:
            count, room = len(planes), ceiling - floor
            text = f"{count} planes that may meet over the ground do not fit into {room:.0f} m of height"
            expected = "farther places, fewer planes or more height"
            raise BadInput(text, field="vehicles", value=planes[i].vehicle, expected=expected)
    return [_slot(planes, i, settled, near, gap) for i in range(len(planes))]


def _slot(
    planes: Sequence[Circling],
    i: int,
    heights: dict[int, float],
    near: dict[tuple[int, int], bool],
    gap: dict[tuple[int, int], float],
) -> LoiterCircle:
    plane, now, then = planes[i], -planes[i].pos_ned[2], heights[i]
    first = tuple(
        other.vehicle
        for j, other in enumerate(planes)
        if j != i and near[i, j] and _goes_first((-other.pos_ned[2], heights[j]), (now, then), gap[i, j])
    )
    centre = (plane.goal_ned[0], plane.goal_ned[1], -then)
    return LoiterCircle(plane.vehicle, centre, loiter_radius(plane.body), loiter_speed(plane.body), first)


def _goes_first(other: tuple[float, float], one: tuple[float, float], gap: float) -> bool:
    """Whether ``other`` must have changed its height (now, then) before ``one`` may: it is in the way now, and goes."""
    (theirs, after), (now, then) = other, one
    ahead = theirs > now if then > now else theirs < now
    return ahead and theirs != after and min(now, then) - gap < theirs < max(now, then) + gap


def _gap(a: Body, b: Body, downwash: float) -> float:
    """m of height between two planes that may be above each other."""
    return downwash * (a.radius + b.radius) + 2.0 * STEADY


def _near(a: Circling, b: Circling) -> bool:
    """Whether the ways over the ground, circles at both ends included, come near each other."""
    keep = sum(2.0 * loiter_radius(one.body) + one.body.radius + ASIDE for one in (a, b))
    one, other = (shapely.linestrings([each.pos_ned[:2], each.goal_ned[:2]]) for each in (a, b))
    return bool(shapely.distance(one, other) < keep)
