"""Several ways through one area flown at once: in which direction, how much later and how much higher each goes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.planner.goals import timing
from agents.planner.model.problem import Floats, Motion, Path
from agents.planner.model.separation import separation

DELAYS = np.arange(0.0, 61.0, 2.0)
"""s by which a vehicle sets out later, in the order in which they are tried"""
SPARE = 0.1
"""m more than the radii ask for, which hold what a vehicle may be off its way already"""


@dataclass(frozen=True)
class Way:
    """A way that is to be flown, its corners rounded already."""

    curve: Path
    limits: timing.Limits
    """of this vehicle alone: (1,) each"""
    radius: float


@dataclass(frozen=True)
class DirectedWay:
    """How a way is flown beside the others."""

    motion: Motion
    backwards: bool
    delay: float
    lift: float
    """m above the way"""


def together(
    ways: Sequence[Way], idle: Sequence[tuple[Floats, float]], downwash: float, top: float
) -> list[DirectedWay]:
    """Motions from t = 0 that keep apart from each other, and from ``idle`` others (place, radius), which stand.

    The longest is placed first, each of the others as soon as it may: forwards or backwards, then later, then higher,
    but never above ``top``. A way for which nothing helps is flown as it is, for the verifier to find.
    """
    plain = [motion_of(way) for way in ways]
    standing = [(np.array([[0.0, *place]]), radius) for place, radius in idle]
    found: dict[int, DirectedWay] = {}
    for i in sorted(range(len(ways)), key=lambda k: -plain[k][-1, 0]):
        others = standing + [(found[k].motion, ways[k].radius) for k in found]
        found[i] = _place(ways[i], plain[i], others, downwash, top)
    return [found[i] for i in range(len(ways))]


def motion_of(way: Way) -> Motion:
    points = way.curve[:, None, :]
    return np.ascontiguousarray(timing.fly(points, way.limits)[:, 0])


def _place(way: Way, plain: Motion, others: list[tuple[Motion, float]], downwash: float, top: float) -> DirectedWay:
    step = (2.0 * max([way.radius, *(radius for _, radius in others)]) + SPARE) * downwash
    room = max(0.0, top - float(way.curve[:, 2].max()))
    lifts = [k * step for k in range(5) if k * step <= room]
    back = motion_of(Way(way.curve[::-1], way.limits, way.radius))
    for lift, delay, backwards in itertools.product(lifts, DELAYS, (False, True)):
        motion = shifted(back if backwards else plain, float(delay), lift)
        if all(separation(motion, other, downwash)[0] >= way.radius + radius + SPARE for other, radius in others):
            return DirectedWay(motion, backwards, float(delay), lift)
    return DirectedWay(plain, False, 0.0, 0.0)


def shifted(motion: Motion, delay: float, lift: float) -> Motion:
    """The motion so much later and higher; it stands at its first place until then."""
    moved: Motion = motion + np.array([delay, 0.0, 0.0, lift])
    if delay <= 0.0:
        return moved
    later: Motion = np.vstack(([0.0, *moved[0, 1:]], moved))
    return later
