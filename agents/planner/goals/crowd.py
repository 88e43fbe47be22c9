"""Several ways through one area flown at once: in which direction, and how much later each goes."""

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


def together(ways: Sequence[Way], idle: Sequence[tuple[Floats, float]], downwash: float) -> list[tuple[Motion, bool]]:
    """Motions from t = 0, and whether each goes backwards, that keep apart from each other, and from ``idle`` others
    (place, radius), which stand.

    The longest is placed first, each of the others as soon as it may: forwards or backwards, then later. A way for
    which nothing helps is flown as it is, for the verifier to find.
    """
    plain = [motion_of(way) for way in ways]
    standing = [(np.array([[0.0, *place]]), radius) for place, radius in idle]
    found: dict[int, tuple[Motion, bool]] = {}
    for i in sorted(range(len(ways)), key=lambda k: -plain[k][-1, 0]):
        others = standing + [(found[k][0], ways[k].radius) for k in found]
        found[i] = _place(ways[i], plain[i], others, downwash)
    return [found[i] for i in range(len(ways))]


def motion_of(way: Way) -> Motion:
    return np.ascontiguousarray(timing.fly(way.curve[:, None, :], way.limits)[:, 0])


def _place(way: Way, plain: Motion, others: list[tuple[Motion, float]], downwash: float) -> tuple[Motion, bool]:
    back = motion_of(Way(way.curve[::-1], way.limits, way.radius))
    for delay, backwards in itertools.product(DELAYS, (False, True)):
        motion = shifted(back if backwards else plain, float(delay))
        if all(separation(motion, other, downwash)[0] >= way.radius + radius + SPARE for other, radius in others):
            return motion, backwards
    return plain, False


def shifted(motion: Motion, delay: float) -> Motion:
    """The motion so much later; it stands at its first place until then."""
    moved: Motion = motion + np.array([delay, 0.0, 0.0, 0.0])
    return np.vstack(([0.0, *moved[0, 1:]], moved)) if delay > 0.0 else moved
