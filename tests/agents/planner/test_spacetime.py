"""Ways and times in tight places: apart at every instant, clear of what stands, at speeds that can be flown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import segment_clear
from agents.planner.model.problem import Floats, Motion, MovingObstacle, Path, Problem, problem_of
from agents.planner.model.scene import Bounds, Box, Scene, Vehicle
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import World, world_of
from agents.planner.solve.refine.knots import leg_times
from agents.planner.solve.spacetime import deconflict
from agents.planner.solve.spacetime.deconflict import Negotiation, find
from agents.planner.solve.spacetime.table import Table, empty_table, put, take, trouble, troubles
from tests.agents.planner import generate

AREA = np.array([-20.0, -20.0, 20.0, 20.0])


def ready(scene: Scene, movers: Sequence[MovingObstacle] = ()) -> tuple[Problem, World, list[Path]]:
    problem = problem_of(scene, movers=movers)
    static = StaticMap(world_of(scene))
    return problem, static.world, static.paths_for(problem)


def sampled(motion: Motion, times: Floats) -> Floats:
    """(T, 3), held before and after."""
    return np.stack([np.interp(times, motion[:, 0], motion[:, axis]) for axis in (1, 2, 3)], axis=1)


def nearest(motions: Sequence[Motion], radii: Sequence[float], downwash: float) -> float:
    """The least distance of two less their radii, by looking every 20 ms."""
    times = np.arange(0.0, max(motion[-1, 0] for motion in motions) + 0.1, 0.02)
    scaled = [sampled(motion, times) / np.array([1.0, 1.0, downwash]) for motion in motions]
    worst = np.inf
    for i in range(len(motions)):
        for j in range(i):
            gap = np.linalg.norm(scaled[i] - scaled[j], axis=1).min() - radii[i] - radii[j]
            worst = min(worst, float(gap))
    return worst


def judge(problem: Problem, world: World, motions: Sequence[Motion] | None) -> None:
    """Everything that is promised of motions that were found."""
    assert motions is not None
    every = [*motions, *(mover.motion for mover in problem.movers)]
    radii = [*problem.radius, *(mover.radius for mover in problem.movers)]
    assert nearest(every, radii, problem.downwash) > -0.001
    for i, motion in enumerate(motions):
        assert np.allclose(motion[0, 1:], problem.start[i])
        assert np.allclose(motion[-1, 1:], problem.goal[i])
        legs, times = np.diff(motion[:, 1:], axis=0), np.diff(motion[:, 0])
        assert (times > 0.0).all()
        assert (np.linalg.norm(legs, axis=1) <= 0.81 * problem.vmax[i] * times).all()
        assert (legs[:, 2] <= 0.81 * problem.climb[i] * times).all()
        assert (-legs[:, 2] <= 0.81 * problem.descend[i] * times).all()
        for a, b in zip(motion[:-1, 1:], motion[1:, 1:], strict=True):
            assert segment_clear(world, np.ascontiguousarray(a), np.ascontiguousarray(b), problem.radius[i] - 1e-6)


def copter(name: str, start: tuple[float, float, float], goal: tuple[float, float, float]) -> Vehicle:
    return Vehicle(id=name, type="copter", start=start, goal=goal, radius=1.0, vmax=5.0, amax=2.5)


def corridor(*, bay: bool, kind: str = "copter") -> Scene:
    """Two that change places in a corridor in which only one has room, but for a bay half-way."""
    walls = [Box(min=(-20.0, -6.0, 0.0), max=(20.0, -1.5, 5.0)), Box(min=(-20.0, 1.5, 0.0), max=(-2.0, 6.0, 5.0))]
    walls.append(Box(min=(2.0 if bay else -2.0, 1.5, 0.0), max=(20.0, 6.0, 5.0)))
    ends = [(-12.0, 0.0, 2.0), (12.0, 0.0, 2.0)]
    vehicles = [
        Vehicle(id=f"v{i}", type=kind, start=ends[i], goal=ends[1 - i], radius=1.0, vmax=5.0, amax=2.5)  # type: ignore[arg-type]
        for i in (0, 1)
    ]
    return Scene(
        vehicles=vehicles,
        obstacles=list(walls),
        bounds=Bounds(min=(-20.0, -6.0, 0.0), max=(20.0, 6.0, 4.0)),
        downwash=1.5,
    )


# The table.


def table_of(count: int, seed: int, *, filed: bool = True) -> Table:
    """Bodies that wander about, now and then standing still."""
    rng = np.random.default_rng(seed)
    scene = Scene(
        vehicles=[copter(f"v{i}", (3.0 * i - 15.0, 0.0, 0.0), (3.0 * i - 15.0, 0.0, 0.0)) for i in range(count)],
        bounds=Bounds(min=(-20.0, -20.0, 0.0), max=(20.0, 20.0, 9.0)),
        downwash=1.5,
    )
    table = empty_table(problem_of(scene), 0.25, 40, AREA, 5.0, 0.0)
    for body in range(count):
        steps = rng.uniform(-0.7, 0.7, (40, 3)) * (rng.random((40, 1)) < 0.7)
        table.places[body] = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0))) + rng.uniform(-4.0, 4.0, 3)
        if filed:
            put(table, body)
    return table


def test_what_is_too_near_in_the_table_is_what_looking_closely_finds() -> None:
    table, shares = table_of(12, 1), np.linspace(0.0, 1.0, 400)[:, None]
    scale = np.array([1.0, 1.0, 1.5])
    met = 0
    for body in range(12):
        counts = np.zeros(12, dtype=np.int64)
        assert troubles(table, body, counts) == counts.sum()
        for other in range(12):
            steps = 0
            for k in range(40):
                ours, theirs = table.places[body], table.places[other]
                gap = (ours[k] - theirs[k]) * (1.0 - shares) + (ours[k + 1] - theirs[k + 1]) * shares
                steps += bool(np.linalg.norm(gap / scale, axis=1).min() < table.apart[body, other] - 1e-9)
            if other != body:
                assert abs(counts[other] - steps) <= (0 if steps == 0 else 1)
                met += steps
    assert met > 50


def test_a_motion_taken_out_leaves_nothing_behind() -> None:
    table, empty = table_of(8, 2), table_of(8, 2, filed=False)
    for body in (3, 0, 7, 5, 1, 6, 2, 4):
        take(table, body)
    assert np.array_equal(table.head, empty.head)
    assert not table.stir.any()


def test_a_price_is_the_sum_of_the_weights_of_all_in_the_way() -> None:
    table = table_of(3, 3, filed=False)
    table.places[0], table.places[1] = (1.0, 0.0, 2.0), (-1.0, 0.0, 2.0)
    put(table, 0)
    put(table, 1)
    weight = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 5.0, 0.0]])
    at = [trouble(table, weight, 2, 7, x, 0.0, 2.0, x, 0.0, 2.0) for x in (-5.0, -2.0, 0.0, 2.0, 5.0)]
    assert at == [0.0, 5.0, 7.0, 2.0, 0.0]
    assert trouble(table, weight, 2, 7, -6.0, 0.0, 2.0, 6.0, 0.0, 2.0) == 7.0
    assert trouble(table, weight, 2, 7, 0.0, 0.0, 5.1, 0.0, 0.0, 5.1) == 0.0


# Everybody.


@pytest.mark.parametrize(("kind", "count"), [("gate_opposing", 10), ("tunnel", 6), ("shuffle", 36), ("fence", 8)])
def test_tight_places_are_passed(kind: str, count: int) -> None:
    problem, world, paths = ready(getattr(generate, kind)(count, 3))
    judge(problem, world, find(problem, world, paths, Deadline.after(30.0), np.random.default_rng(0)))


def test_no_finer_lattice_where_the_first_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    class Noted(Negotiation):
        def __init__(self, *args: Any, fine: float = 1.0, **more: Any) -> None:
            asked.append(fine)
            super().__init__(*args, fine=fine, **more)

    monkeypatch.setattr(deconflict, "Negotiation", Noted)
    problem, world, paths = ready(generate.gate_opposing(16, 1))
    motions = find(problem, world, paths, Deadline.after(300.0), np.random.default_rng(0))
    assert motions is not None
    assert max(motion[-1, 0] for motion in motions) > 1.3 * max(leg_times(problem, 0, p).sum() for p in paths)
    assert asked == [1.0, 1.0]


def test_two_pass_in_a_bay() -> None:
    for kind in ("copter", "rover"):
        problem, world, paths = ready(corridor(bay=True, kind=kind))
        motions = find(problem, world, paths, Deadline.after(20.0), np.random.default_rng(0))
        judge(problem, world, motions)
        assert motions is not None
        assert kind == "copter" or all((motion[:, 3] == 2.0).all() for motion in motions)


def test_two_that_cannot_pass_are_given_up_in_time() -> None:
    problem, world, paths = ready(corridor(bay=False))
    assert find(problem, world, paths, Deadline.after(0.2), np.random.default_rng(0)) is None


def test_movers_are_kept_clear_of_and_free_the_way_when_they_leave() -> None:
    scene = Scene(
        vehicles=[copter("v0", (-12.0, 0.0, 5.0), (12.0, 0.0, 5.0))],
        bounds=Bounds(min=(-20.0, -20.0, 0.0), max=(20.0, 20.0, 10.0)),
        downwash=1.5,
    )
    across = np.array([[0.0, 0.0, -12.0, 5.0], [6.0, 0.0, 12.0, 5.0]])
    on_the_goal = np.array([[0.0, 12.0, 0.0, 5.0], [8.0, 12.0, 1.0, 5.0]])
    movers = [MovingObstacle("a", across, 3.0), MovingObstacle("b", on_the_goal, 1.0, leaves=True)]
    problem, world, paths = ready(scene, movers)
    motions = find(problem, world, paths, Deadline.after(10.0), np.random.default_rng(0))
    assert motions is not None
    times = np.arange(0.0, 8.0, 0.02)
    for mover in movers:
        gap = np.linalg.norm(sampled(motions[0], times) - sampled(mover.motion, times), axis=1).min()
        assert gap >= 1.0 + mover.radius - 0.001
    assert 8.0 < motions[0][-1, 0] < 12.0
    stays = [MovingObstacle("b", on_the_goal, 1.0)]
    problem, world, paths = ready(scene, stays)
    assert find(problem, world, paths, Deadline.after(0.2), np.random.default_rng(0)) is None


def test_the_same_seed_gives_the_same_motions() -> None:
    problem, world, paths = ready(generate.shuffle(25, 1))
    one, two = (find(problem, world, paths, Deadline.after(60.0), np.random.default_rng(5)) for _ in range(2))
    assert one is not None
    assert two is not None
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
