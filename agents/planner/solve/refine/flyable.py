"""Refinement: from ways, or timed motions, to samples that every vehicle can fly and that keep all apart.

First with coarse knots from several guesses (everybody on their way at once, bent aside and spread in height so that
few meet head-on), each with a little more time than the last; then with knots as near to each other as the samples of a
plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import World, segment_clear
from agents.planner.model.problem import ROVER, Floats, Ints, Motion, Path, Problem
from agents.planner.solve.jit import jit
from agents.planner.solve.refine.knots import durations, knots_of_motions, knots_of_paths, resampled, samples_of
from agents.planner.solve.refine.swarm import Swarm, Worst, units


@dataclass(frozen=True)
class Guess:
    """How ways are bent before anything else, in radii at most (short ways less)."""

    side: float = 0.5
    """to the right"""
    up: float = 0.0
    """between the highest and the lowest, sorted by course"""
    noise: float = 0.05
    """at random, so that nothing is exactly symmetric"""


def bent(
    problem: Problem, world: World, paths: list[Path], seconds: float, knots: int, guess: Guess, seed: int
) -> Floats:
    """(N, knots + 1, 3): ways flown in ``seconds``, bent where the bent way is clear."""
    place = knots_of_paths(problem, paths, seconds, knots)
    rng = np.random.default_rng(seed)
    across = problem.goal - problem.start
    length = np.linalg.norm(across, axis=1)
    level = np.hypot(across[:, 0], across[:, 1])
    right = np.column_stack([across[:, 1], -across[:, 0], np.zeros(len(problem))]) / np.maximum(level, 1e-6)[:, None]
    unit = units(problem)[0]
    reach = unit * np.minimum(1.0, 0.15 * length / (unit * max(guess.side, guess.up, 1e-6)))
    course = np.arctan2(across[:, 1], across[:, 0])
    rank = np.argsort(np.argsort(course, kind="stable"), kind="stable") / max(1, len(problem) - 1) - 0.5
    # What there is of height may not reach for the whole spread: it is moved up or down to fit.
    middle = 0.5 * (problem.start[:, 2] + problem.goal[:, 2])
    low, high = world.bounds[2] + 0.1, world.bounds[5] - 0.1
    if len(world.fence):
        low, high = max(low, world.fence_z[0] + 0.1), min(high, world.fence_z[1] - 0.1)
    lift = np.clip(middle + guess.up * rank * reach, low, high) - middle
    lift = np.where(problem.kind == ROVER, 0.0, lift)
    bend = guess.side * reach[:, None] * right
    bend[:, 2] += lift
    jitter = guess.noise * rng.standard_normal((len(problem), 3)) * reach[:, None]
    jitter[problem.kind == ROVER, 2] = 0.0
    hump = np.sin(np.pi * np.linspace(0.0, 1.0, knots + 1))[:, None]
    for i in range(len(problem)):
        aside(world, place[i], (bend[i] + jitter[i]) * hump, float(problem.radius[i]))
    return place


@jit
def aside(world: World, way: Floats, offset: Floats, radius: float) -> None:
    """Move each knot of a way by its offset, or by the share of it for which there is room there and next to it."""
    last = way.shape[0] - 1
    room = np.ones(last + 1)
    for k in range(1, last):
        while room[k] > 0.05 and not segment_clear(world, way[k], way[k] + room[k] * offset[k], radius):
            room[k] *= 0.6
        if room[k] <= 0.05:
            room[k] = 0.0
    for turn in range(2):  # what is narrow narrows what comes before and after it, less so further away
        for n in range(1, last + 1):
            k = n if turn == 0 else last - n
            before = k - 1 if turn == 0 else k + 1
            room[k] = min(room[k], room[before] + 0.1)
    for k in range(1, last):
        way[k] += room[k] * offset[k]


FINE_STEP = 0.195  # s; a plan has at least five samples a second
COARSE_STEP = 0.4
FACTORS = (1.03, 1.12, 1.25, 1.45, 1.75)
GUESSES = (Guess(), Guess(side=3.0, up=8.0), Guess(side=5.0, up=16.0))  # radii
ROUND = 0.1  # radii aside for each vehicle: so many that cross in one place go round it, all in one sense
CAP = 1.0  # radii
SQUEEZED = 0.3  # the same for motions whose order is to be kept
SLIDE = 0.6  # how much two pass beside each other rather than one before the other
HEAT = 16  # steps
TRIALS = 5
PACE = 1.004  # a speed over its limit by 0.4 %, an acceleration by 0.8 % are left to a slower clock


@dataclass
class Refined:
    """What refinement came to; ``motions`` is None where it failed."""

    motions: list[Motion] | None
    place: Floats | None = None
    """(N, K + 1, 3): the knots, for a next time"""
    seconds: float = 0.0
    stuck: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """the vehicles that were still too near to something in the best try"""


def refine_paths(
    problem: Problem,
    world: World,
    paths: list[Path],
    deadline: Deadline,
    seed: int = 0,
    factors: tuple[float, ...] = FACTORS,
    hopeless: float = 1.0,
) -> Refined:
    """Motions along ways. Tries go from short to long.

    No longer ones are made when more than this share of all, ``hopeless``, is stuck in the best of those of a length.
    """
    least = float(durations(problem, paths).max(initial=0.0))
    if least <= 0.0:
        return Refined([np.array([[0.0, *p]]) for p in problem.start])
    best = Refined(None)
    for factor in factors:
        for swarm in race(problem, world, paths, least * factor, seed, deadline):
            if deadline.over:
                return best
            result = settle_and_finish(swarm, deadline)
            if result.motions is not None:
                return result
            if best.place is None or len(result.stuck) < len(best.stuck):
                best = result
        if len(best.stuck) > hopeless * len(problem):
            break
    return best


def race(
    problem: Problem, world: World, paths: list[Path], seconds: float, seed: int, deadline: Deadline
) -> Iterator[Swarm]:
    """First guesses, all stepped a little; those that have come furthest first."""
    field: list[tuple[float, int, Swarm]] = []
    side = ROUND * len(problem)
    guesses = (*GUESSES, Guess(side=side, up=16.0)) if side > GUESSES[-1].side else GUESSES
    for m, guess in enumerate(guesses):
        place = bent(problem, world, paths, seconds, coarse_knots(problem, seconds), guess, seed + m)
        swarm = Swarm(problem, world, place, seconds)
        for _ in range(HEAT):
            worst = swarm.look(SLIDE)
            if deadline.over or (worst.total == 0.0 and worst.pace <= PACE):
                break
            swarm.bend(CAP * swarm.length)
        broken = swarm.look(SLIDE).total
        if broken < 0.01 * swarm.length * len(problem):
            yield swarm
            if m == len(guesses) - 1:
                break
        else:
            field.append((broken, m, swarm))
    yield from (swarm for _, _, swarm in sorted(field, key=lambda entry: entry[:2]))


def refine(problem: Problem, world: World, motions: list[Motion], deadline: Deadline) -> Refined:
    """Motions that can be flown near to given ones that keep apart; the order in which they pass is kept."""
    span = max((float(m[-1, 0]) for m in motions), default=0.0)
    best = Refined(None)
    for stretch in (1.0, 1.2, 1.5, 2.0, 3.0):
        if deadline.over:
            break
        seconds = span * stretch
        place = knots_of_motions(motions, seconds, coarse_knots(problem, seconds), stretch)
        best = settle_and_finish(Swarm(problem, world, place, seconds), deadline, SQUEEZED)
        if best.motions is not None:
            break
    return best


def squeeze(problem: Problem, world: World, found: Refined, floor: float, deadline: Deadline) -> Refined:
    """The same in less time, as long as that goes well and it takes more than ``floor`` s."""
    cut = 0.85
    for _ in range(TRIALS):
        if found.place is None or cut > 0.97 or deadline.over:
            break
        seconds = max(floor, found.seconds * cut)
        if seconds > 0.98 * found.seconds:
            break
        place = resampled(found.place, coarse_knots(problem, seconds))
        tried = settle_and_finish(Swarm(problem, world, place, seconds), deadline, SQUEEZED)
        if tried.motions is not None and tried.seconds < 0.99 * found.seconds:
            found = tried
        else:
            cut = 1.0 - 0.5 * (1.0 - cut)
    return found


def coarse_knots(problem: Problem, seconds: float) -> int:
    return max(8, int(np.ceil(seconds / (COARSE_STEP * min(1.0, units(problem)[1])))))


def settle_and_finish(swarm: Swarm, deadline: Deadline, slide: float = SLIDE) -> Refined:
    worst = settle(swarm, deadline, 160, slide)
    if worst.overlap > 0.15 or worst.depth > 0.15:
        return Refined(None, swarm.place.copy(), swarm.seconds, worst.by)
    return finish(swarm, deadline, slide)


def settle(swarm: Swarm, deadline: Deadline, steps: int, slide: float) -> Worst:
    """Step until nothing is broken, with a little more time whenever it does not come to an end."""
    worst = swarm.look(slide)
    broken = np.inf
    for n in range(steps):
        if worst.overlap == 0.0 and worst.depth == 0.0 and worst.pace <= PACE:
            break
        if n % 20 == 19:
            if deadline.over:
                break
            now = float(worst.overlap + worst.depth)
            if n > 60 and now > 0.5 and now > 0.8 * broken:
                break
            broken = now
            swarm.slow(min(1.03, max(1.01, worst.pace)))
        swarm.bend(CAP * swarm.length)
        worst = swarm.look(slide)
    return worst


def finish(swarm: Swarm, deadline: Deadline, slide: float) -> Refined:
    """Knots as near to each other as samples, then the clock as slow as the limits need."""
    for _ in range(3):
        knots = max(swarm.place.shape[1] - 1, int(np.ceil(swarm.seconds / FINE_STEP)))
        swarm.set(resampled(swarm.place, knots), swarm.seconds)
        worst = settle(swarm, deadline, 100, slide)
        if worst.overlap > 0.0 or worst.depth > 0.0:
            return Refined(None, swarm.place.copy(), swarm.seconds, worst.by)
        if worst.pace > 1.0:
            swarm.slow(worst.pace + 1e-4)
        if swarm.h <= 0.2 and not (swarm.problem.movers and swarm.look(slide).overlap > 0.0):
            return Refined(samples_of(swarm.place, swarm.seconds), swarm.place.copy(), swarm.seconds)
    return Refined(None, swarm.place.copy(), swarm.seconds, worst.by)
