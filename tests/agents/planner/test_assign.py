"""Who goes to which goal: the last arrival as early as can be, and ways that do not cross."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from agents.planner.model.geometry import world_of
from agents.planner.model.scene import Bounds, Box, Obstacle, Scene, Vehicle
from agents.planner.solve.assign import SLACK, assign, bottleneck, costs


def scene_of(
    starts: list[tuple[float, float, float]],
    goals: list[tuple[float, float, float]],
    speeds: list[float] | None = None,
    obstacles: list[Obstacle] | None = None,
) -> Scene:
    vehicles = [
        Vehicle(id=f"v{i}", type="copter", start=s, radius=0.5, vmax=speeds[i] if speeds else 5.0, amax=2.5)
        for i, s in enumerate(starts)
    ]
    bounds = Bounds(min=(-50.0, -50.0, 0.0), max=(50.0, 50.0, 30.0))
    return Scene(vehicles=vehicles, assignment="unlabelled", goals=goals, obstacles=obstacles or [], bounds=bounds)


@pytest.mark.parametrize("seed", range(4))
def test_the_last_arrival_is_as_early_as_any_assignment_makes_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = [tuple(p) for p in rng.uniform(1.0, 29.0, (12, 3)).tolist()]
    scene = scene_of(places[:6], places[6:], speeds=rng.uniform(1.0, 9.0, 6).tolist())
    world = world_of(scene)
    times, _ = costs(scene, world, np.array(scene.goals))
    best = min(max(times[i, j] for i, j in enumerate(order)) for order in permutations(range(6)))
    assert bottleneck(times) == pytest.approx(best)
    chosen = assign(scene, world)
    assert chosen is not None
    assert sorted(chosen) == list(range(6))
    assert max(times[i, j] for i, j in enumerate(chosen)) <= SLACK * best + 1e-9


def test_a_row_moves_over_without_crossing() -> None:
    starts = [(float(x), 0.0, 10.0) for x in range(0, 20, 4)]
    goals = [(float(x), 20.0, 10.0) for x in range(16, -4, -4)]
    scene = scene_of(starts, goals)
    assert assign(scene, world_of(scene)) == [4, 3, 2, 1, 0]


def test_a_goal_behind_a_wall_is_left_to_whoever_sees_it() -> None:
    wall = Box(min=(-1.0, -49.0, 0.0), max=(1.0, 20.0, 30.0))
    starts, goals = [(-10.0, 0.0, 10.0), (9.0, 9.0, 10.0)], [(10.0, 0.0, 10.0), (-8.0, 12.0, 10.0)]
    scene = scene_of(starts, goals, obstacles=[wall])
    assert assign(scene, world_of(scene)) == [1, 0]


def test_vehicles_with_goals_of_their_own_keep_them() -> None:
    scene = scene_of([(0.0, 0.0, 5.0)], [(1.0, 1.0, 5.0)])
    scene.assignment = "labelled"
    assert assign(scene, world_of(scene)) is None


def test_a_rover_gets_a_goal_on_its_own_height() -> None:
    scene = scene_of([(0.0, 0.0, 0.0), (4.0, 0.0, 10.0)], [(4.0, 20.0, 0.0), (0.0, 20.0, 10.0)])
    scene.vehicles[0].type = "rover"
    assert assign(scene, world_of(scene)) == [0, 1]
