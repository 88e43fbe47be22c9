"""Planes among everything else: Dubins ways flown at once, apart from each other and from what moves.

Planes can neither wait nor stand. They are planned first, one after another, each as the quickest of many ways that
is clear of the world, of the planes before it and of all places where others start or are to stay; the others then
avoid them. A plane that finds none goes first next time (prioritised planning after Erdmann and Lozano-Perez, 1987,
with the order changed as by Bennewitz and others, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from agents.planner.model.deadline import NEVER, Deadline
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import PLANE, Floats, Motion, Problem
from agents.planner.model.separation import least_between
from agents.planner.model.world import World
from agents.planner.solve.paths.flight import WORDS, Wings, end_of, fly, gentle, join, motion_clear, way_clear

SPEEDS = 4
"""speeds, from the least to the greatest, for whose turns ways are made, and at which they are flown"""
SLACK = 0.02
"""m that everything is farther away than it must be, for samples are rounded"""
VIAS = (60, 250)
"""ways by a random place: how many are tried first, and when all else failed"""
OFFSETS = (6.0, -6.0, 12.0, -12.0, 18.0, -18.0, 24.0, -24.0, 32.0, -32.0, 40.0, -40.0)
"""m by which the middle of a way may be higher"""
ATTEMPTS, POLISH = 40, 8
"""orders of the planes that are tried until there is a plan, and until it is a good one"""
GOOD = 1.15
"""times the least there can be is good: no more is looked for"""
LEVELS = 4
TIGHTER = 1.05
"""times the acceleration, of which a little is spared, where it finds no way with that: all of it is what it may use"""


class Plane:
    """One plane's ways, the quickest first; each level has more of them, and costs more to make."""

    def __init__(
        self, problem: Problem, world: World, index: int, posts: Floats, wings: Wings, rng: np.random.Generator
    ) -> None:
        self.index = index
        self.wings = wings
        self._world, self._posts, self._squash, self._rng = world, posts, problem.downwash, rng
        self._pose = np.array([*problem.start[index], problem.heading[index]])
        self._goal = problem.goal[index]
        self._limit = problem.time_limit
        self._ways: list[Floats] = []
        self._levels: list[list[Motion]] = []

    def motions(self, level: int) -> list[Motion]:
        """Those of a level from 0 to ``LEVELS`` - 1; each is clear of the world and the posts, and can be flown."""
        makers: tuple[Callable[[], Iterator[Motion]], ...] = (
            self._direct,
            self._aside,
            self._circling,
            lambda: self._by_vias(VIAS[1]),
        )
        while len(self._levels) <= level:
            made = [*(self._levels[-1] if self._levels else []), *makers[len(self._levels)]()]
            self._levels.append(sorted(made, key=lambda motion: float(motion[-1, 0])))
        return self._levels[level]

    def _flown(self, legs: Floats, cap: float) -> Iterator[Motion]:
        """The motion of a way whose curve is clear: once more checked as it is sampled."""
        motion = np.round(fly(self._pose, legs, self.wings, cap), 6)
        if not len(motion) or motion[-1, 0] > self._limit:
            return
        if motion_clear(self._world, self._posts, self._squash, motion, self.wings.radius - SLACK / 2.0):
            yield motion

    def _clear(self, legs: Floats) -> bool:
        clear = way_clear(self._world, self._posts, self._squash, self._pose, legs, self.wings.radius)
        return clear and gentle(legs, self.wings)

    def _caps(self) -> list[float]:
        return [float(speed) for speed in np.linspace(self.wings.vmin, self.wings.vmax, SPEEDS)]

    def _direct(self) -> Iterator[Motion]:
        """The shortest for each radius."""
        for turn in map(self.wings.turn, self._caps()):
            for word in range(WORDS):
                legs = join(self._pose, self._goal, turn, word)
                known = any(legs is not None and _same(legs, other) for other in self._ways)
                if legs is not None and not known and self._clear(legs):
                    self._ways.append(legs)
        for legs in self._ways:
            yield from self._flown(legs, self.wings.vmax)

    def _aside(self) -> Iterator[Motion]:
        """The same ways more slowly, and higher or lower in their middle; and ways around."""
        yield from self._by_vias(VIAS[0])
        for legs in self._ways:
            for cap in self._caps()[:-1]:
                yield from self._flown(legs, cap)
            total = legs[:, 1].sum()
            for offset in OFFSETS:
                for cap in self._caps()[1::2]:
                    bent = halved(legs, total / 2.0)
                    lengths = np.cumsum(bent[:, 1])
                    bent[:, 2] += np.where(lengths <= total / 2.0 + 1e-9, 1.0, -1.0) * bent[:, 1] * 2.0 * offset / total
                    if self._clear(bent):
                        yield from self._flown(bent, cap)

    def _by_vias(self, count: int) -> Iterator[Motion]:
        """By a place somewhere beside the straight line, with the turns of any speed."""
        start, goal = self._pose[:3], self._goal
        middle, reach = (start + goal) / 2.0, max(float(np.linalg.norm(goal - start)), 6.0 * self.wings.tightest) / 2.0
        low = np.maximum(self._world.bounds[:3], middle - 1.2 * reach)
        high = np.minimum(self._world.bounds[3:], middle + 1.2 * reach)
        for _ in range(count):
            via = self._rng.uniform(low, high)
            via[2] = np.clip(self._rng.normal(middle[2], 20.0), low[2], high[2])
            cap = float(self._rng.choice(self._caps()))
            turn = self.wings.turn(cap)
            one = _shortest([join(self._pose, via, turn, word) for word in range(WORDS)])
            if one is None:
                continue
            other = _shortest([join(end_of(self._pose, one), goal, turn, word) for word in range(WORDS)])
            if other is not None and self._clear(legs := np.concatenate((one, other))):
                yield from self._flown(legs, cap)

    def _circling(self) -> Iterator[Motion]:
        """A circle or two first, or on the way."""
        for legs in self._ways:
            for turn in map(self.wings.turn, self._caps()):
                for side in (1.0, -1.0):
                    for rounds in (1, 2, 3):
                        for place in (0, len(legs)):
                            circle = np.array([[side / turn, 2.0 * math.pi * turn * rounds, 0.0]])
                            longer = np.concatenate((legs[:place], circle, legs[place:]))
                            rise = self._goal[2] - self._pose[2]
                            longer[:, 2] = rise * longer[:, 1] / longer[:, 1].sum()
                            if self._clear(longer):
                                yield from self._flown(longer, self.wings.vmax)


def _same(a: Floats, b: Floats) -> bool:
    return a.shape == b.shape and bool(np.allclose(a, b, atol=1e-6))


def _shortest(ways: Sequence[Floats | None]) -> Floats | None:
    return min((legs for legs in ways if legs is not None), key=lambda legs: float(legs[:, 1].sum()), default=None)


def halved(legs: Floats, at: float) -> Floats:
    """The same way with the leg that passes ``at`` metres cut there."""
    ends = np.cumsum(legs[:, 1])
    k = min(int(np.searchsorted(ends, at)), len(legs) - 1)
    share = min(1.0, max(0.0, (at - ends[k] + legs[k, 1]) / legs[k, 1]))
    parts = np.array([[legs[k, 0], share * legs[k, 1], share * legs[k, 2]], legs[k] * [1.0, 1.0 - share, 1.0 - share]])
    return np.concatenate((legs[:k], parts[parts[:, 1] > 1e-6], legs[k + 1 :]))


def wings_of(problem: Problem, index: int) -> Wings:
    """What a plane of a problem can do; its radius has a little room added."""
    p = problem
    return Wings(
        radius=float(p.radius[index]) + SLACK,
        vmin=float(p.vmin[index]),
        vmax=float(p.vmax[index]),
        amax=float(p.amax[index]),
        climb=float(p.climb[index]),
        descend=float(p.descend[index]),
    )


def posts_of(problem: Problem, index: int, places: Sequence[Floats]) -> Floats:
    """(M, 4): where others than planes are at these ``places``, (N, 3) each, and how far a plane keeps from them."""
    apart = problem.radius + problem.radius[index] + SLACK
    rows = [[*place[k], apart[k]] for place in places for k in np.flatnonzero(problem.kind != PLANE)]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def _plane(problem: Problem, world: World, index: int, rng: np.random.Generator) -> Plane:
    """A plane with its ways: off all posts where that can be, else off the starts, else off none of them.

    Raises :class:`PlanError` ``unreachable`` where there is no way even so.
    """
    wings = wings_of(problem, index)
    for amax in (wings.amax, TIGHTER * wings.amax):
        for places in ((problem.start, problem.goal), (problem.start,), ()):
            posts = posts_of(problem, index, places)
            plane = Plane(problem, world, index, posts, wings._replace(amax=amax), rng)
            if any(plane.motions(level) for level in range(LEVELS)):
                return plane
    name = problem.ids[index]
    text = f"no way leads {name} to its goal: it turns within {wings.vmin**2 / wings.amax:.0f} m at its slowest"
    raise PlanError("unreachable", [name], text)


def plan_planes(
    problem: Problem, world: World, indices: Sequence[int], rng: np.random.Generator, deadline: Deadline = NEVER
) -> list[Motion]:
    """Motions (T, 4) of the planes ``indices``, in that order: from the start at its heading to the goal, flying.

    They keep off each other, off ``problem.movers``, and off the starts and goals of all others where that can be.
    Raises :class:`PlanError` ``unreachable`` for a plane that has no way at all, and ``timeout`` where none was found
    for all together until the ``deadline``; where there is one by then, no better one is looked for.
    """
    planes: dict[int, Plane] = {}
    for index in indices:
        if deadline.over:
            name = problem.ids[index]
            raise PlanError("timeout", [name], f"no way of {name} was looked for in time; allow more time")
        planes[index] = _plane(problem, world, index, rng)
    bounds = {
        i: float(np.linalg.norm(problem.goal[i] - problem.start[i]) / problem.vmax[i]) for i in range(len(problem))
    }
    enough = GOOD * max(bounds.values())
    order = sorted(indices, key=lambda i: -bounds[i])
    best: dict[int, Motion] = {}
    takes = math.inf
    for attempt in range(ATTEMPTS):
        if attempt and deadline.over:
            break
        found: dict[int, Motion] = {}
        stuck = next((i for i in order if not _place_one(problem, planes[i], found, deadline)), None)
        last = max(order, key=lambda i: float(found[i][-1, 0])) if stuck is None else stuck
        if stuck is None and found[last][-1, 0] < takes:
            best, takes = found, float(found[last][-1, 0])
        if takes <= enough or (best and attempt >= POLISH):
            break
        # The one that found no way, or the longest, chooses first the next time.
        rest = [i for i in order if i != last]
        order = [last, *(rest if attempt % 2 == 0 else [rest[k] for k in rng.permutation(len(rest))])]
    if not best and indices:
        name = problem.ids[order[0]]
        text = f"no way of {name} was found that is clear of the other planes' ways"
        raise PlanError("timeout", [name], f"{text}; allow more time" if deadline.over else text)
    return [best[index] for index in indices]


def _place_one(problem: Problem, plane: Plane, found: dict[int, Motion], deadline: Deadline) -> bool:
    """Choose the quickest way that is clear of those found before; False: there is none, or no time to make more."""
    for level in range(LEVELS):
        if level and deadline.over:
            return False
        motions = plane.motions(level)
        for motion in motions:
            if level == 0 and motion[-1, 0] > GOOD * motions[0][-1, 0]:
                break  # the next level has quicker ones
            if _free(problem, plane.index, motion, found):
                found[plane.index] = motion
                return True
    return False


def _free(problem: Problem, index: int, motion: Motion, found: dict[int, Motion]) -> bool:
    others = [(track, float(problem.radius[k]), True) for k, track in found.items()]
    others += [(np.ascontiguousarray(m.motion), m.radius, m.leaves) for m in problem.movers]
    keep, inverse = float(problem.radius[index]) + SLACK, 1.0 / problem.downwash
    return all(
        least_between(motion, track, inverse, True, leaves, 0.0)[0] >= keep + radius for track, radius, leaves in others
    )
