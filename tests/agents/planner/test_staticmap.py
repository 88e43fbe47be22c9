"""The static map: a way for each, and who cannot get to his goal."""

from __future__ import annotations

import numpy as np
import pytest

from agents.planner.model import geometry
from agents.planner.model.deadline import Deadline
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Floats, Problem, problem_of
from agents.planner.model.scene import Bounds, Box, Cylinder, NoFly, Obstacle, Scene, Vehicle
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import world_of


def scene(*obstacles: Obstacle) -> Scene:
    bounds = Bounds(min=(-60, -60, 0), max=(60, 60, 30))
    return Scene(vehicles=[], obstacles=list(obstacles), bounds=bounds)


def towers(rng: np.random.Generator, count: int) -> list[Obstacle]:
    made: list[Obstacle] = []
    for kind, (x, y, size, high) in zip(
        rng.integers(3, size=count), rng.uniform((-50, -50, 2, 10), (50, 50, 6, 30), (count, 4)).tolist(), strict=True
    ):
        if kind == 0:
            made.append(Box(min=(x, y, 0), max=(x + size, y + size, high)))
        elif kind == 1:
            made.append(Cylinder(center=(x, y), radius=size / 2, floor=0, ceiling=high))
        else:
            made.append(NoFly(polygon=[(x, y), (x + size, y + 1), (x + 1, y + size)], floor=0, ceiling=high))
    return made


def trips(rng: np.random.Generator, world: geometry.World, count: int) -> list[Floats]:
    """(2, 3) each: starts and goals that are free."""
    found: list[Floats] = []
    while len(found) < count:
        ends = rng.uniform((-58, -58, 1), (58, 58, 12), (2, 3))
        if all(geometry.away(world, x, y, z, 1.0, np.empty(3)) == 0.0 for x, y, z in ends):
            found.append(ends)
    return found


def copters(
    *trips: tuple[tuple[float, float, float], tuple[float, float, float]], obstacles: list[Obstacle]
) -> Problem:
    vehicles = [
        Vehicle(id=f"v{i}", type="copter", start=start, goal=goal, radius=1.0, vmax=5.0, amax=2.0)
        for i, (start, goal) in enumerate(trips)
    ]
    return problem_of(Scene(vehicles=vehicles, obstacles=obstacles, bounds=scene().bounds))


def walls(x: float) -> list[Obstacle]:
    """A closed cell about (x, 0)."""
    sides = [(x - 10, -10, 0, x - 9, 10, 12), (x + 9, -10, 0, x + 10, 10, 12), (x - 10, -10, 0, x + 10, -9, 12)]
    sides += [(x - 10, 9, 0, x + 10, 10, 12), (x - 10, -10, 12, x + 10, 10, 13)]
    return [Box(min=(a, b, c), max=(d, e, f)) for a, b, c, d, e, f in sides]


@pytest.mark.usefixtures("hasty")
def test_all_that_cannot_get_to_their_goals_are_named() -> None:
    obstacles = [*walls(-20.0), *walls(20.0)]
    problem = copters(
        ((-50, -50, 5), (50, 50, 5)),
        ((-50, -40, 5), (-20, 0, 5)),
        ((-22, 3, 5), (-18, -3, 5)),
        ((-22, 6, 5), (22, 0, 5)),
        ((-50, 40, 5), (18, 0, 5)),
        obstacles=obstacles,
    )
    there = StaticMap(world_of(scene(*obstacles)))
    with pytest.raises(PlanError) as raised:
        there.paths_for(problem)
    assert raised.value.kind == "unreachable" and raised.value.ids == ["v1", "v3", "v4"]
    del obstacles[4]  # the first cell's roof
    there = StaticMap(world_of(scene(*obstacles)))
    with pytest.raises(PlanError) as raised:
        there.paths_for(problem)
    assert raised.value.ids == ["v3", "v4"]


def test_a_way_for_each_in_order() -> None:
    obstacles = towers(np.random.default_rng(1), 20)
    world = world_of(scene(*obstacles))
    ends = trips(np.random.default_rng(2), world, 10)
    problem = copters(*((tuple(a), tuple(b)) for a, b in ends), obstacles=obstacles)
    paths = StaticMap(world).paths_for(problem)
    assert len(paths) == 10 and any(len(path) > 2 for path in paths)
    for path, (start, goal) in zip(paths, ends, strict=True):
        assert (path[0] == start).all() and (path[-1] == goal).all()
        assert all(geometry.segment_clear(world, path[i], path[i + 1], 1.0) for i in range(len(path) - 1))


def gapped(gap: float) -> Scene:
    """Two rooms, small enough to be looked all through, and a gap between them, not where anybody would look first."""
    walls: list[Obstacle] = [
        Box(min=(-8.0, -20.0, 0.0), max=(8.0, 13.3, 20.0)),
        Box(min=(-8.0, 13.3 + gap, 0.0), max=(8.0, 20.0, 20.0)),
    ]
    bounds = Bounds(min=(-20.0, -20.0, 0.0), max=(20.0, 20.0, 20.0))
    one = Vehicle(
        id="a", type="copter", start=(-10.0, -10.0, 5.0), goal=(10.0, -10.0, 5.0), radius=1.0, vmax=5.0, amax=2.5
    )
    return Scene(vehicles=[one], obstacles=walls, bounds=bounds)


def test_a_way_is_missing_for_certain_or_for_lack_of_time() -> None:
    """Through a window that is too narrow, and through one that is wide enough, but not where anybody looks first."""
    problem, there = problem_of(gapped(1.9)), StaticMap(world_of(gapped(1.9)))
    with pytest.raises(PlanError) as caught:
        there.paths_for(problem, until=Deadline.after(0.0))
    assert (caught.value.kind, caught.value.ids) == ("timeout", ["a"])
    with pytest.raises(PlanError) as caught:
        there.paths_for(problem)
    assert (caught.value.kind, caught.value.ids) == ("unreachable", ["a"])
    assert len(StaticMap(world_of(gapped(2.02))).paths_for(problem)) == 1
