"""The space-time optimiser: what it bends is flyable, and keeps all apart at every instant."""

from __future__ import annotations

import numpy as np
import pytest

from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import world_of
from agents.planner.model.problem import MovingObstacle, Problem, problem_of
from agents.planner.model.scene import Bounds, Cylinder, Scene, Vehicle
from agents.planner.model.separation import separation
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.verify import verify
from agents.planner.solve.refine import flyable
from agents.planner.solve.refine.flyable import FACTORS, Refined, refine, refine_paths
from agents.planner.solve.refine.knots import durations, knots_of_paths, ramped, resampled
from agents.planner.solve.refine.swarm import Swarm
from tests.agents.planner.generate import CLASSES


def circle(n: int, across: float = 40.0, **more: object) -> Scene:
    """n copters on a circle, each to the opposite place."""
    vehicles = []
    for i in range(n):
        x, y = across / 2 * np.cos(2 * np.pi * i / n), across / 2 * np.sin(2 * np.pi * i / n)
        vehicles.append(
            Vehicle(id=f"v{i}", type="copter", start=(x, y, 20.0), goal=(-x, -y, 20.0), radius=1.0, vmax=5.0, amax=2.5)
        )
    bounds = Bounds(min=(-across, -across, 2.0), max=(across, across, 40.0))
    return Scene(vehicles=vehicles, bounds=bounds, downwash=1.5, **more)  # type: ignore[arg-type]


def bent(scene: Scene, problem: Problem | None = None) -> Refined:
    problem = problem or problem_of(scene)
    ways = [np.array(ends) for ends in zip(problem.start, problem.goal, strict=True)]
    return refine_paths(problem, world_of(scene), ways, Deadline.after(60.0))


def test_a_circle_swaps_within_a_tenth_more_than_the_bound() -> None:
    scene = circle(12)
    found = bent(scene)
    assert found.motions is not None
    report = verify(scene, dict(zip([v.id for v in scene.vehicles], found.motions, strict=True)))
    assert report.ok, report.faults[:3]
    assert report.makespan < 1.1 * (40.0 / 5.0 + 5.0 / 2.5)


def test_a_post_in_the_middle_is_flown_round() -> None:
    scene = circle(6, obstacles=[Cylinder(center=(8.0, 0.5), radius=1.0, floor=0.0, ceiling=40.0)])
    found = bent(scene)
    assert found.motions is not None
    report = verify(scene, dict(zip([v.id for v in scene.vehicles], found.motions, strict=True)))
    assert report.ok, report.faults[:3]
    assert report.obstacle_clearance >= 0.0


def test_what_moves_by_itself_is_kept_clear_of_at_its_own_times() -> None:
    scene = circle(4)
    across = np.array([[0.0, -20.0, -20.0, 20.0], [11.0, 20.0, 20.0, 20.0]])
    stays = MovingObstacle("ball", across, 3.0)
    problem = problem_of(scene, movers=[stays])
    found = bent(scene, problem)
    assert found.motions is not None
    for motion in found.motions:
        assert separation(motion, across, 1.5)[0] >= 3.999


def test_what_leaves_is_gone_after_its_last_sample() -> None:
    scene = circle(2)
    gone = MovingObstacle("plane", np.array([[0.0, 0.0, 12.0, 20.0], [2.0, 0.0, 0.0, 20.0]]), 4.0, leaves=True)
    problem = problem_of(scene, movers=[gone])
    swarm = Swarm(
        problem,
        world_of(scene),
        knots_of_paths(problem, [np.array([v.start, v.goal]) for v in scene.vehicles], 12.0, 60),
        12.0,
    )
    swarm.look()
    stays = Swarm(
        problem_of(scene, movers=[MovingObstacle("rock", gone.motion, 4.0)]), world_of(scene), swarm.place.copy(), 12.0
    )
    # Both lots meet in the middle; only with the rock is somebody deep in it then.
    assert swarm.look().overlap == pytest.approx(2.0, abs=0.1)
    assert stays.look().overlap > 4.0


def test_waits_of_given_motions_are_kept_where_there_is_need_of_them() -> None:
    scene = circle(2, across=20.0)
    one = np.array([[0.0, 10.0, 0.0, 20.0], [3.0, 0.0, 4.0, 20.0], [6.0, -10.0, 0.0, 20.0]])
    two = np.array([[0.0, -10.0, 0.0, 20.0], [8.0, -10.0, 0.0, 20.0], [13.0, 10.0, 0.0, 20.0]])
    found = refine(problem_of(scene), world_of(scene), [one, two], Deadline.after(60.0))
    assert found.motions is not None
    report = verify(scene, {"v0": found.motions[0], "v1": found.motions[1]})
    assert [f for f in report.faults if f.kind == "separation"] == []


def test_nobody_moves_who_is_at_the_goal() -> None:
    scene = circle(3)
    for v in scene.vehicles:
        v.goal = v.start
    found = bent(scene)
    assert found.motions is not None
    assert [motion.tolist() for motion in found.motions] == [[[0.0, *v.start]] for v in scene.vehicles]


def test_the_progress_law_keeps_to_its_limits() -> None:
    problem = problem_of(circle(1))
    ways = [np.array([problem.start[0], problem.goal[0]])]
    seconds = float(durations(problem, ways)[0])
    assert seconds == pytest.approx(40.0 / 5.0 + 5.0 / 2.5)
    place = knots_of_paths(problem, ways, seconds, 1000)[0]
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1) * 1000 / seconds
    assert speed.max() == pytest.approx(5.0, rel=1e-3)
    assert np.abs(np.diff(speed)).max() * 1000 / seconds == pytest.approx(2.5, rel=1e-2)
    assert ramped(np.array([0.0, 0.5, 1.0]), 0.2).tolist() == [0.0, 0.5, 1.0]


def test_finer_knots_lie_on_the_same_curve() -> None:
    times = np.linspace(0.0, np.pi, 41)
    place = np.column_stack([times, np.cos(times), 0 * times])[None]
    fine = resampled(place, 160)[0]
    inner = slice(8, -8)
    assert np.abs(np.cos(fine[inner, 0]) - fine[inner, 1]).max() < 1e-3
    assert np.array_equal(fine[0], place[0, 0])
    assert np.array_equal(fine[-1], place[0, -1])


def test_no_longer_try_where_most_are_in_each_others_way(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = CLASSES["tunnel"](8, 0)
    problem, static = problem_of(scene), StaticMap(world_of(scene))
    real, told = flyable.settle_and_finish, list[float]()

    def counted(swarm: Swarm, deadline: Deadline, slide: float = flyable.SLIDE) -> flyable.Refined:
        told.append(swarm.seconds)
        return real(swarm, deadline, slide)

    monkeypatch.setattr(flyable, "settle_and_finish", counted)
    for hopeless, tries in ((0.2, 3), (1.0, 6)):
        told.clear()
        until = Deadline.after(600.0)
        ways = static.paths_for(problem)
        found = refine_paths(problem, static.world, ways, until, 0, FACTORS[:2], hopeless)
        assert found.motions is None
        assert len(found.stuck) > 0.2 * len(problem)
        assert len(told) == tries
