"""One after another: everybody flies a way of his own as he would alone, and leaves so late that nobody is met.

For two ways at given times the delays of one against the other with which they come too near are a set of numbers,
found once. What is left is to choose delays: in some order, each the least that is free of those chosen before. Where
nobody's way leads past another's start or goal there always is one, however narrow the ways are; and where one does,
the other one goes first, or last, or a way around is looked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.planner.model.deadline import Deadline
from agents.planner.model.problem import Floats, Ints, Motion, Path, Problem, places_at
from agents.planner.model.scene import Cylinder, Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import World, world_of
from agents.planner.solve.jit import jit
from agents.planner.solve.refine.knots import leg_times, ramped
from agents.planner.solve.spacetime.table import distances, least, stepped

Bools = NDArray[np.bool_]
Alone = Callable[[int, World, Path], Motion | None]
"""the motion of one vehicle through a world along a way, from rest to rest, as if there were nobody else"""
STEP = 0.2
"""s, of delays"""
SAMPLE = 0.1
"""s between the samples of :func:`stopping`"""
ORDERS = 60
"""looked at for a shorter plan, at most"""
SECONDS = 2.0
"""of the processor for these"""
AROUND = 0.5
"""s for a way around others' starts and goals"""
MOST_LOOKS = 1_000_000_000
"""pairs of steps that are looked at for two ways: a second or two"""
SPARE = 1.05
"""times what two need between them is kept from others' starts and goals by a way around them"""


@jit
def bar(ours: Floats, theirs: Floats, gap: float, squeeze: float, stays: bool, out: Bools) -> bool:
    """Mark the delays with which two come nearer than ``gap``; False: none.

    ``ours`` (K + 1, 3), ``theirs`` (L + 1, 3): places at equal steps, straight between; at rest before, and after
    (theirs where it ``stays``). ``out`` (K + L + 1,): number K + d is that ours leaves d steps after theirs; the first
    and the last stand for all that are beyond.
    """
    k, n = len(ours) - 1, len(theirs) - 1
    found = False
    for a in range(-1, k + 1):
        p, q = ours[max(a, 0)], ours[min(a + 1, k)]
        for b in range(-1, n + 1):
            if ((a < 0 or a == k) and (b < 0 or b == n)) or (b == n and not stays):
                continue
            r, s = theirs[max(b, 0)], theirs[min(b + 1, n)]
            ax, ay, bx, by = p[0] - r[0], p[1] - r[1], q[0] - s[0], q[1] - s[1]
            if min(ax, bx) > gap or max(ax, bx) < -gap or min(ay, by) > gap or max(ay, by) < -gap:
                continue
            if least(ax, ay, (p[2] - r[2]) / squeeze, bx, by, (q[2] - s[2]) / squeeze) >= gap * gap:
                continue
            found = True
            if a < 0:  # ours waits at its start while theirs passes
                out[k + b + 1 :] = True
            elif a == k:
                out[: b + 1] = True
            elif b < 0:
                out[: k - a] = True
            elif b == n:
                out[k + n - a :] = True
            else:
                out[k + b - a] = True
    return found


@dataclass(frozen=True)
class Turns:
    """Ways with their times, and which delays of any two against each other are barred."""

    steps: Sequence[int]
    """of each way"""
    bars: dict[tuple[int, int], Bools]
    """of i's delay less j's, and of j's less i's; none for those that never meet. Movers come after the vehicles"""
    movers: int

    def earliest(self, i: int, delays: dict[int, int], horizon: int) -> int | None:
        """The least delay that is free of all that have one."""
        blocked = np.zeros(horizon + 1, dtype=np.bool_)
        when = np.arange(horizon + 1) + self.steps[i]
        for j, delay in delays.items():
            barred = self.bars.get((i, j))
            if barred is not None:
                blocked |= barred[np.clip(when - delay, 0, len(barred) - 1)]
        return None if blocked.all() else int(np.argmin(blocked))

    def scheduled(self, order: Sequence[int]) -> dict[int, int] | None:
        """Delays of all, chosen in this order or, where one's way leads past another's place, one near to it."""
        waiting, moved = list(order), 0
        delays = {len(order) + m: 0 for m in range(self.movers)}
        placed = 0
        while placed < len(waiting):
            i = waiting[placed]
            horizon = max((delay + self.steps[j] for j, delay in delays.items()), default=0) + 1
            delay = self.earliest(i, delays, horizon)
            if delay is not None:
                delays[i] = delay
                placed += 1
                continue
            # It must go before some that have gone: it is moved before the first of them.
            late = [n for n, j in enumerate(waiting[:placed]) if (i, j) in self.bars and self.bars[i, j][-1]]
            moved += 1
            if not late or moved > len(order):
                return None
            waiting.insert(late[0], waiting.pop(placed))
            placed = late[0]
            delays = {j: delay for j, delay in delays.items() if j >= len(order) or j in waiting[:placed]}
        return delays

    def last(self, delays: dict[int, int]) -> int:
        """The step in which the last vehicle arrives."""
        return max(delay + self.steps[i] for i, delay in delays.items() if i < len(self.steps) - self.movers)

    def best(self, until: Deadline, rng: np.random.Generator) -> dict[int, int] | None:
        """Delays with which all have arrived early, as orders go that were tried."""
        count = len(self.steps) - self.movers
        longest = np.argsort(-np.array(self.steps[:count]), kind="stable")
        best: dict[int, int] | None = None
        best_order = order = longest
        for turn in range(ORDERS):
            delays = self.scheduled(order.tolist())
            if delays is not None and (best is None or self.last(delays) <= self.last(best)):
                best, best_order = delays, order
            if until.over and turn > 1:
                break
            if turn == 0:
                order = longest[::-1]
            elif best is None:
                order = rng.permutation(count)
            else:  # who arrives last goes earlier
                last = int(np.argmax([best[i] + self.steps[i] for i in range(count)]))
                order = np.insert(best_order[best_order != last], int(rng.integers(0, count)), last)
        return best


def in_turn(
    problem: Problem,
    scene: Scene,
    world: World,
    paths: Sequence[Path],
    alone: Alone,
    deadline: Deadline,
    rng: np.random.Generator,
) -> list[Motion] | None:
    """Motions of all that keep apart, one later than another; None: there are no such on ways that were found."""

    def motion_of(i: int, around: World, path: Path) -> Motion:
        motion = alone(i, around, path)
        return stopping(problem, i, path) if motion is None else motion

    found = [motion_of(i, world, path) for i, path in enumerate(paths)]
    motions = delayed(problem, found, deadline, rng)
    if motions is None:
        for i in [i for i, motion in enumerate(found) if len(posts_of(problem, i, motion))]:
            if deadline.over:
                return None
            posted, way = _around(problem, scene, i, deadline)
            if way is not None:
                found[i] = motion_of(i, posted, way)
        motions = delayed(problem, found, deadline, rng)
    return motions


def stopping(problem: Problem, i: int, path: Path) -> Motion:
    """A motion exactly along a way that comes to rest at each corner."""
    rows, now, ramp = [[0.0, *path[0]]], 0.0, float(problem.vmax[i] / problem.amax[i])
    for leg, cruise in enumerate(leg_times(problem, i, path).tolist()):
        if cruise <= 0.0:
            continue
        takes = cruise + ramp if cruise >= ramp else 2.0 * float(np.sqrt(cruise * ramp))
        share = np.linspace(0.0, 1.0, int(np.ceil(takes / SAMPLE)) + 1)[1:]
        place = path[leg] + ramped(share, ramp / takes)[:, None] * (path[leg + 1] - path[leg])
        rows += np.column_stack((now + share * takes, place)).tolist()
        now += takes
    return np.array(rows)


def delayed(
    problem: Problem, motions: Sequence[Motion], deadline: Deadline, rng: np.random.Generator
) -> list[Motion] | None:
    turns = turns_of(problem, motions, deadline)
    delays = None if turns is None else turns.best(deadline.within(SECONDS), rng)
    if delays is None:
        return None
    late = []
    for i, motion in enumerate(motions):
        later = np.round(motion, 6)
        later[:, 0] = np.round(later[:, 0] + delays[i] * STEP, 6)
        late.append(later if delays[i] == 0 else np.concatenate((later[:1] * [0.0, 1.0, 1.0, 1.0], later)))
    return late


def turns_of(problem: Problem, motions: Sequence[Motion], until: Deadline) -> Turns | None:
    """What is barred for these motions and the problem's movers; None: there was no time, or they last too long."""
    count, squeeze = len(motions), problem.downwash
    strays = np.concatenate((problem.amax * STEP * STEP / 8.0, np.zeros(len(problem.movers))))
    places = [_places(motion) for motion in motions]
    for m, mover in enumerate(problem.movers, count):
        track, strays[m] = stepped(mover, STEP, max(1, int(np.ceil(mover.motion[-1, 0] / STEP))))
        places.append(np.ascontiguousarray(track))
    ends = np.array([[place[0], place[-1]] for place in places[count:]]).reshape(-1, 2, 3)
    apart = distances(problem, ends, strays, 0.0)
    low, high = (np.array([end(place, axis=0) for place in places]) for end in (np.min, np.max))
    bars: dict[tuple[int, int], Bools] = {}
    for i in range(count):
        if until.over:
            return None
        for j in range(i + 1, len(places)):
            gap = float(apart[i, j])
            if (low[i, :2] > high[j, :2] + gap).any() or (low[j, :2] > high[i, :2] + gap).any():
                continue
            if len(places[i]) * len(places[j]) > MOST_LOOKS:
                return None
            out = np.zeros(len(places[i]) + len(places[j]) - 1, dtype=np.bool_)
            stays = j < count or not problem.movers[j - count].leaves
            if bar(places[i], places[j], gap, squeeze, stays, out):
                bars[i, j], bars[j, i] = out, out[::-1]
    return Turns([len(place) - 1 for place in places], bars, len(problem.movers))


def _places(motion: Motion) -> Floats:
    """(K + 1, 3): where a motion is at each step, at its end at last."""
    steps = max(1, int(np.ceil(motion[-1, 0] / STEP - 1e-9)))
    return np.ascontiguousarray(places_at(motion, np.arange(steps + 1, dtype=np.float64) * STEP))


def posts_of(problem: Problem, i: int, motion: Motion | None = None) -> Ints:
    """Numbers of the others' starts (j) and goals (N + j) that are near a motion, or (None) that can be kept off."""
    scale = np.array([1.0, 1.0, problem.downwash])
    every = np.concatenate((problem.start, problem.goal)) / scale
    wide = np.tile(problem.radius, 2) + problem.radius[i]
    own = np.tile(np.arange(len(problem)) == i, 2)
    ends = np.array([problem.start[i], problem.goal[i]]) / scale

    def nearest(places: Floats) -> Floats:
        return np.asarray(np.linalg.norm(every[:, None] - places[None], axis=2).min(axis=1))

    free = ~own & (nearest(ends) > SPARE * wide)
    if motion is not None:
        free &= nearest(_places(motion) / scale) < wide
    return np.flatnonzero(free)


def _around(problem: Problem, scene: Scene, i: int, deadline: Deadline) -> tuple[World, Path | None]:
    """The world with the starts and goals of all others in it, but those at a vehicle's own; and a way through it."""
    posts, count, radius = [], len(problem), float(problem.radius[i])
    for post in posts_of(problem, i).tolist():
        x, y, z = (problem.start if post < count else problem.goal)[post % count].tolist()
        wide = SPARE * (float(problem.radius[post % count]) + radius)
        tall = wide * problem.downwash - radius
        posts.append(Cylinder(center=(x, y), radius=wide - radius, floor=z - tall, ceiling=z + tall))
    around = Scene(vehicles=[], obstacles=[*scene.obstacles, *posts], bounds=scene.bounds, geofence=scene.geofence)
    rates = [float(rate[i]) for rate in (problem.vmax, problem.climb, problem.descend)]
    ends = problem.start[i], problem.goal[i], radius, int(problem.kind[i])
    static = StaticMap(world_of(around))
    return static.world, static.path(*ends, rates, until=deadline.within(AROUND))
