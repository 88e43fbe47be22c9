"""From a scene to a verified plan: the stages one after another, and what is tried when one does not come through."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.errors import Code, PlanError
from agents.planner.model.geometry import World, away, world_of
from agents.planner.model.plans import Plan
from agents.planner.model.problem import (
    PLANE,
    Floats,
    Ints,
    Motion,
    MovingObstacle,
    Path,
    Problem,
    places_at,
    problem_of,
)
from agents.planner.model.scene import Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.validate import validate
from agents.planner.model.verify import Report, verify
from agents.planner.solve import jit
from agents.planner.solve.assign import assign
from agents.planner.solve.planes import plan_planes
from agents.planner.solve.refine.flyable import FACTORS, FINE_STEP, Refined, refine, refine_paths, squeeze
from agents.planner.solve.refine.knots import durations
from agents.planner.solve.spacetime import deconflict
from agents.planner.solve.spacetime.turns import in_turn

TOLERATED = 0.006  # m; the format lets 1 cm pass
LONG = 1.1  # times what the ways take; a plan that takes longer is worth making shorter
ROOM = 0.1  # radii; with so much more between obstacles, ways can be bent and their corners cut
SHARES = 8  # of a margin
EFFORT, EFFORT_FOR = 3.0, 30.0  # s to find something shorter than a queue, and as much again for so many vehicles
MOST_SAMPLES = 1_000_000  # of all motions of a plan together, five a second: 0.4 GB in the space-time optimiser
CROWDED = 0.5  # share of all; when so many are in each other's way, it is a narrow place that they must pass in turn


def solve(
    scene: Scene,
    *,
    static: StaticMap | None = None,
    movers: Sequence[MovingObstacle] = (),
    seconds: float | None = None,
    seed: int = 0,
    margin: float = 0.0,
) -> Plan:
    """A verified plan of a scene.

    ``static``: what is known of the scene's obstacles from before. ``movers`` are kept clear of. ``seconds``: of this
    thread's processor time that it may search (None: a minute, and half a second for each vehicle), and
    :data:`~agents.planner.model.deadline.WALL` times as long by the clock; call
    :func:`agents.planner.solve.warm.warm` before, as compiling takes half a minute of them. ``margin``: m that two
    vehicles keep on top of their radii, and half of it to obstacles, as far as starts and goals leave room for it. The
    same seed gives the same plan unless time runs out.
    Raises :class:`PlanError`.
    """
    begun, least = time.monotonic(), 60.0 + 0.5 * len(scene.vehicles) if seconds is None else seconds
    tracks, _ = Pipeline(scene, static, tuple(movers), least, seed, margin).run()
    return Plan.of(tracks, time.monotonic() - begun)


@dataclass
class Pipeline:
    """One scene on its way through the stages; arguments as of :func:`solve`."""

    scene: Scene
    static: StaticMap | None
    movers: tuple[MovingObstacle, ...]
    seconds: float
    seed: int = 0
    margin: float = 0.0

    def __post_init__(self) -> None:
        self.deadline, self.begun = Deadline.after(self.seconds), time.monotonic()

    def run(self) -> tuple[dict[str, Motion], Report]:
        """Verified motions by vehicle, and what the verifier says of them. Raises :class:`PlanError`."""
        validate(self.scene)
        static = self.static or StaticMap(world_of(self.scene))
        world = static.world
        problem, planes, others, paths = self.dealt(static)
        stuck: list[str] = list(problem.ids)
        for motions in self.candidates(problem, world, planes, others, paths):
            if isinstance(motions, list):
                tracks = dict(zip(problem.ids, motions, strict=True))
                report = verify(self.scene, tracks, self.movers)
                if report.ok:
                    return tracks, report
                stuck = report.culprits()
            else:
                stuck = [problem.ids[i] for i in others[motions]] or stuck
            if self.deadline.over:
                break
        busy, spent = self.seconds - (self.deadline.processor - time.thread_time()), time.monotonic() - self.begun
        text = f"no plan was found in {busy:.1f} s of the processor ({spent:.1f} s by the clock)"
        text += f" that keeps {', '.join(stuck[:5])} apart from all else"
        raise PlanError("timeout", stuck, f"{text}; allow more time, or more room")

    def dealt(self, static: StaticMap) -> tuple[Problem, Ints, Ints, list[Path]]:
        """Goals and ways for all, and who is a plane and who not; goals that can be chosen go to who can get there.

        Radii have the margin in them: the ways are those of what is flown in the end.
        """
        count = len(self.scene.vehicles)
        never = np.zeros((count, count), dtype=np.bool_)
        while True:
            chosen = assign(self.scene, static.world, never if never.any() else None)
            problem = problem_of(self.scene, chosen, self.movers)
            planes = np.flatnonzero(problem.kind == PLANE)
            others = np.flatnonzero(problem.kind != PLANE)
            clear_of_movers(problem)
            problem = fitted(problem, static.world, self.margin)
            room = ROOM * float(problem.radius[others].min(initial=np.inf))
            try:
                paths = static.paths_for(part(problem, others), room, self.deadline) if len(others) else []
                takes = np.zeros(count)
                takes[others] = durations(part(problem, others), paths)
                check_length(problem, takes)
                return problem, planes, others, paths
            except PlanError as e:
                known = never.sum()
                for i in (problem.ids.index(name) for name in e.ids if chosen is not None):
                    never[i, (chosen or [])[i]] = True
                if e.kind != "unreachable" or never.sum() == known or self.deadline.over:
                    if e.kind == "unreachable" and self.margin > 0.0:
                        text = f"{e.message} with {self.margin / 2:g} m more than its radius; allow less margin"
                        raise PlanError(e.kind, e.ids, text) from None
                    raise

    def candidates(
        self, problem: Problem, world: World, planes: Ints, others: Ints, paths: list[Path]
    ) -> Iterator[list[Motion] | Ints]:
        """Motions for all, in order, that may pass the verifier; or the numbers of those that a try left too near."""
        for turn in range(100):
            rng = np.random.default_rng((self.seed, turn))
            fixed: list[Motion] = []
            if len(planes):
                until = half(self.deadline) if len(others) else self.deadline
                try:
                    fixed = plan_planes(problem, world, planes.tolist(), rng, until)
                except PlanError as e:
                    if turn > 0 and e.kind == "timeout":
                        return  # others were too near the planes' first ways: that is what is to be said
                    raise
            aside = tuple(
                MovingObstacle(problem.ids[i], motion, float(problem.radius[i]), leaves=True)
                for i, motion in zip(planes, fixed, strict=True)
            )
            rest = replace(part(problem, others), movers=problem.movers + aside)
            for found in self.tries(rest, world, paths, rng, turn):
                if found.motions is None:
                    yield found.stuck
                    continue
                motions: list[Motion] = [np.empty((0, 4))] * len(problem)
                for i, motion in zip([*planes, *others], [*fixed, *found.motions], strict=True):
                    motions[i] = motion
                yield motions
            if self.deadline.over:
                return

    def tries(
        self, problem: Problem, world: World, paths: list[Path], rng: np.random.Generator, turn: int
    ) -> Iterator[Refined]:
        """What is tried for all but the planes, from quick to thorough."""
        if not len(problem):
            yield Refined([])
            return
        seed = self.seed + 1000 * turn
        least = float(durations(problem, paths).max(initial=0.0))

        def shorter(found: Refined) -> Refined:
            if found.motions is None or found.seconds < LONG * least:
                return found
            return squeeze(problem, world, found, FACTORS[0] * least, self.deadline)

        def direct(more: int, factors: tuple[float, ...], deadline: Deadline, hopeless: float = 1.0) -> Refined:
            return shorter(refine_paths(problem, world, paths, deadline, seed + more, factors, hopeless))

        def alone(i: int, around: World, path: Path) -> Motion | None:
            single = replace(part(problem, np.array([i])), movers=())
            found = refine_paths(single, around, [path], self.deadline, seed).motions
            return None if found is None else found[0]

        def queued() -> Refined:
            motions = in_turn(problem, self.scene, world, paths, alone, half(self.deadline), rng)
            return Refined(motions, seconds=max((float(motion[-1, 0]) for motion in motions or ()), default=0.0))

        def negotiated(until: Deadline) -> Refined:
            motions = deconflict.find(problem, world, paths, half(until), rng)
            return Refined(None) if motions is None else shorter(refine(problem, world, motions, until))

        yield direct(0, FACTORS[:2], half(self.deadline), CROWDED)
        before = time.monotonic()
        jit.wait_for("discrete")
        self.deadline = self.deadline.later(time.monotonic() - before)
        queue = queued()
        if queue.motions is not None:
            if queue.seconds > LONG * least:
                found = negotiated(self.deadline.within(EFFORT * (1.0 + len(problem) / EFFORT_FOR)))
                if found.motions is not None and found.seconds < queue.seconds:
                    yield found
            yield queue
        yield negotiated(self.deadline)
        yield direct(500, FACTORS[2:], self.deadline)


def check_length(problem: Problem, takes: Floats) -> None:
    """Raises :class:`PlanError` for a plan with more samples than there is memory and time for. ``takes``: s, (N,), of
    the way that each has; planes' are looked for later, and are taken to be straight and flown as slowly as can be.
    """
    away = np.linalg.norm(problem.goal - problem.start, axis=1)
    takes = np.where(problem.kind == PLANE, away / np.maximum(problem.vmin, 1e-9), takes)
    longest = int(takes.argmax())
    samples = len(problem) * float(takes[longest]) / FINE_STEP
    if samples > MOST_SAMPLES:
        name, text = problem.ids[longest], f"{len(problem)} vehicles for so long: {samples:.2g} samples"
        text = f"{name} needs {takes[longest]:.0f} s to its goal, and a plan of {text}, {MOST_SAMPLES:.0e} are most"
        raise PlanError("invalid_scene", [name], text)


def half(deadline: Deadline) -> Deadline:
    return deadline.within(deadline.left() / 2.0)


def clear_of_movers(problem: Problem) -> None:
    """Raises :class:`PlanError` where a mover is on a vehicle's start at first, or stays for good on a vehicle's goal.

    What it did before, at times below 0, does not count.
    """
    scale = np.array([1.0, 1.0, 1.0 / problem.downwash])
    for mover in problem.movers:
        kinds: list[tuple[Code, Floats, Floats]] = [("starts_overlap", problem.start, places_at(mover.motion, 0.0))]
        if not mover.leaves:
            kinds.append(("goals_overlap", problem.goal, mover.motion[-1, 1:]))
        for kind, places, at in kinds:
            near = np.linalg.norm((places - at) * scale, axis=1) < problem.radius + mover.radius - 0.01
            if kind == "goals_overlap":
                near &= problem.kind != PLANE
            if near.any():
                ids = [problem.ids[i] for i in np.flatnonzero(near)]
                what = "start" if kind == "starts_overlap" else "goal"
                text = f"the {what} of {ids[0]} is too near to where {mover.id} {'is' if what == 'start' else 'stays'}"
                raise PlanError(kind, ids, text)


def part(problem: Problem, who: Ints) -> Problem:
    """The same with some of the vehicles only."""
    columns = ("kind", "start", "goal", "radius", "vmax", "amax", "climb", "descend", "vmin", "heading")
    chosen: dict[str, Floats] = {name: np.ascontiguousarray(getattr(problem, name)[who]) for name in columns}
    return replace(problem, ids=tuple(problem.ids[i] for i in who), **chosen)  # type: ignore[arg-type]


def fitted(problem: Problem, world: World, margin: float) -> Problem:
    """Radii larger by half the margin, as far as every vehicle's start and goal leave room for it; smaller by some
    millimetres where starts or goals are nearer than they should be, but by less than the tolerance.

    What there is of the margin is had in :data:`SHARES`, for ways are looked for once for each radius that there is.
    """
    spare = np.full(len(problem), margin / 2)
    scale = np.array([1.0, 1.0, 1.0 / problem.downwash])
    flies = problem.kind == PLANE
    for places, gone in ((problem.start * scale, np.zeros_like(flies)), (problem.goal * scale, flies)):
        gap = np.linalg.norm(places[:, None, :] - places[None, :, :], axis=2)
        gap -= problem.radius[:, None] + problem.radius[None, :]
        gap[gone[:, None] | gone[None, :] | np.eye(len(problem), dtype=np.bool_)] = np.inf
        spare = np.minimum(spare, 0.5 * gap.min(axis=1, initial=np.inf))
    for mover in problem.movers:
        ends = ((problem.start, places_at(mover.motion, 0.0)), (problem.goal, mover.motion[-1, 1:]))
        for ours, its in ends[: 1 if mover.leaves else 2]:
            spare = np.minimum(spare, np.linalg.norm((ours - its) * scale, axis=1) - problem.radius - mover.radius)
    for i in range(len(problem)):
        for place in (problem.start[i], problem.goal[i]):
            wide = problem.radius[i] + margin / 2
            spare[i] = min(spare[i], margin / 2 - away(world, place[0], place[1], place[2], wide, np.empty(3)))
    if margin > 0.0:
        share = margin / 2.0 / SHARES
        spare = np.where(spare > 0.0, np.floor(spare / share + 1e-9) * share, spare)
    return replace(problem, radius=problem.radius + np.maximum(-TOLERATED, spare))
