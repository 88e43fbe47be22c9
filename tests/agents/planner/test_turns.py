"""One after another: which delays are barred, and plans that are nothing but delays."""

from __future__ import annotations

import numpy as np
import pytest

from agents.planner.model.deadline import Deadline
from agents.planner.model.problem import Motion, MovingObstacle, problem_of
from agents.planner.model.scene import Bounds, Scene, Vehicle
from agents.planner.model.separation import separation
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.verify import verify
from agents.planner.model.world import world_of
from agents.planner.solve.spacetime.turns import STEP, delayed, in_turn, stopping, turns_of
from tests.agents.planner import generate

Point = tuple[float, float, float]


def scene_of(*ends: tuple[Point, Point]) -> Scene:
    vehicles = [
        Vehicle(id=f"v{i}", type="copter", start=a, goal=b, radius=1.0, vmax=5.0, amax=2.5)
        for i, (a, b) in enumerate(ends)
    ]
    return Scene(vehicles=vehicles, bounds=Bounds(min=(-40.0, -40.0, 0.0), max=(40.0, 40.0, 20.0)), downwash=1.5)


def moved(motion: Motion, delay: float) -> Motion:
    return np.asarray(motion + np.array([delay, 0.0, 0.0, 0.0]))


def never() -> Deadline:
    return Deadline.after(60.0)


@pytest.mark.parametrize("seed", range(8))
def test_a_delay_is_barred_where_the_two_meet_and_hardly_anywhere_else(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = [tuple(p) for p in rng.uniform((-15.0, -15.0, 4.0), (15.0, 15.0, 8.0), (4, 3)).tolist()]
    problem = problem_of(scene_of((places[0], places[1]), (places[2], places[3])))
    paths = [
        np.array([problem.start[i], rng.uniform((-5.0, -5.0, 3.0), (5.0, 5.0, 13.0)), problem.goal[i]]) for i in (0, 1)
    ]
    motions = [stopping(problem, i, path) for i, path in enumerate(paths)]
    turns = turns_of(problem, motions, never())
    assert turns is not None
    barred = turns.bars.get((0, 1), np.zeros(turns.steps[0] + turns.steps[1] + 1, dtype=np.bool_))
    for number, bar in enumerate(barred.tolist()):
        delay = (number - turns.steps[0]) * STEP
        ours, theirs = moved(motions[0], max(delay, 0.0)), moved(motions[1], max(-delay, 0.0))
        near = separation(ours, theirs, problem.downwash)[0]
        assert near >= 2.0 - 1e-6 or bar
        assert near <= 2.1 or not bar


def test_who_stops_at_corners_keeps_to_the_way_and_to_the_limits() -> None:
    scene = scene_of(((-10.0, 0.0, 5.0), (10.0, 8.0, 9.0)))
    scene.vehicles[0].vz_up = 1.0
    problem = problem_of(scene)
    path = np.array([problem.start[0], [-10.0, 3.0, 5.0], [0.0, 3.0, 5.0], problem.goal[0]])
    motion = stopping(problem, 0, path)
    assert verify(scene, {"v0": np.round(motion, 6)}, written=True).ok
    for corner in path[1:-1]:
        assert np.linalg.norm(motion[:, 1:] - corner, axis=1).min() < 1e-9


@pytest.mark.parametrize(
    ("later", "earlier"),
    [
        (((-2.2, 0.0, 5.0), (20.0, 0.0, 5.0)), ((0.0, 0.0, 5.0), (0.0, 30.0, 5.0))),  # its way leads past a start
        (((0.0, 30.0, 5.0), (0.0, 0.0, 5.0)), ((-30.0, 0.0, 5.0), (20.0, 0.0, 5.0))),  # its goal is on a way
    ],
)
def test_who_must_go_later_does_whatever_the_order(later: tuple[Point, Point], earlier: tuple[Point, Point]) -> None:
    for ends in ((later, earlier), (earlier, later)):
        problem = problem_of(scene_of(*ends))
        ways = zip(problem.start, problem.goal, strict=True)
        motions = [stopping(problem, i, np.stack(way)) for i, way in enumerate(ways)]
        late = delayed(problem, motions, never(), np.random.default_rng(0))
        assert late is not None
        assert separation(late[0], late[1], 1.5)[0] >= 2.0
        waits = [late[i][-1, 0] - motions[i][-1, 0] for i in (0, 1)]
        assert waits[ends.index(earlier)] == pytest.approx(0.0, abs=1e-6)
        assert 0.0 < waits[ends.index(later)] < 6.0


def test_two_that_change_places_on_one_line_have_no_turns_but_with_ways_around() -> None:
    scene = scene_of(((-10.0, 0.0, 5.0), (10.0, 0.0, 5.0)), ((10.0, 0.0, 5.0), (-10.0, 0.0, 5.0)))
    problem = problem_of(scene)
    straight = [np.stack(ends) for ends in zip(problem.start, problem.goal, strict=True)]
    motions = [stopping(problem, i, path) for i, path in enumerate(straight)]
    assert delayed(problem, motions, never(), np.random.default_rng(0)) is None
    bent = [np.insert(path, 1, [0.0, side, 5.0], axis=0) for path, side in zip(straight, (-3.0, 3.0), strict=True)]
    motions = [stopping(problem, i, path) for i, path in enumerate(bent)]
    late = delayed(problem, motions, never(), np.random.default_rng(0))
    assert late is not None and separation(late[0], late[1], 1.5)[0] >= 2.0


def test_a_mover_is_let_pass_and_one_that_leaves_frees_the_goal() -> None:
    scene = scene_of(((-10.0, 0.0, 5.0), (10.0, 0.0, 5.0)))
    track = np.array([[0.0, 10.0, -20.0, 5.0], [8.0, 10.0, 0.0, 5.0]])
    for leaves in (True, False):
        problem = problem_of(scene, movers=[MovingObstacle("m", track, 1.0, leaves=leaves)])
        motions = [stopping(problem, 0, np.stack((problem.start[0], problem.goal[0])))]
        late = delayed(problem, motions, never(), np.random.default_rng(0))
        assert (late is not None) == leaves
        if late is not None:
            assert separation(late[0], track, 1.5, b_leaves=True)[0] >= 2.0


def test_a_queue_through_windows_keeps_every_rule() -> None:
    """Also where nobody has a motion of his own but the one that stops at corners."""
    scene = generate.windows(8, 1)
    problem, static = problem_of(scene), StaticMap(world_of(scene))
    paths = static.paths_for(problem)
    motions = in_turn(problem, scene, static.world, paths, lambda i, w, path: None, never(), np.random.default_rng(0))
    assert motions is not None
    assert verify(scene, dict(zip(problem.ids, motions, strict=True)), written=True).ok


def test_ways_that_last_for_hours_are_not_looked_at_step_by_step() -> None:
    """Of two such each step of the one was looked at against each of the other: for hours, whatever time there was."""
    scene = scene_of(((-10.0, 0.0, 5.0), (10.0, 0.0, 5.0)), ((0.0, -10.0, 5.0), (0.0, 10.0, 5.0)))
    problem = problem_of(scene)
    ends = np.stack((problem.start, problem.goal), axis=1)
    slow = [np.column_stack(([0.0, 1e5], way)) for way in ends]
    assert turns_of(problem, slow, never()) is None
    assert turns_of(problem, [way * [1e-3, 1.0, 1.0, 1.0] for way in slow], never()) is not None
