"""The static map: what it keeps, what a change makes it forget, and who cannot get to his goal."""

from __future__ import annotations

import time

import numpy as np
import pytest

from agents.planner.model import geometry, staticmap
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Floats, Problem, problem_of
from agents.planner.model.scene import Bounds, Box, Cylinder, NoFly, Obstacle, Scene, Vehicle
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import changed, world_of
from agents.planner.solve.paths import grid
from agents.planner.solve.warm import gapped


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
        if all(geometry.clearance(world, *end) > 1.0 for end in ends):
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


def test_a_changed_map_is_as_one_made_again() -> None:
    rng = np.random.default_rng(5)
    obstacles = towers(rng, 30)
    kept = StaticMap(world_of(scene(*obstacles)))
    for _ in range(4):
        for start, goal in trips(rng, kept.world, 12):
            kept.path(start, goal, 1.0)
        out, more = [obstacles[int(i)] for i in rng.choice(len(obstacles), 3, replace=False)], towers(rng, 3)
        kept.update(added=more, removed=out)
        obstacles = [one for one in obstacles if one not in out] + more
        # The same kinds in the same order, as boxes, cylinders and prisms are kept apart.
        again = StaticMap(world_of(scene(*obstacles)))
        for one, other in zip(kept.world, again.world, strict=True):
            np.testing.assert_array_equal(one, other)
        for layer in kept._layers.values():
            xs, ys, zs = layer.lines
            for at in np.nonzero(layer.state != grid.UNKNOWN)[0][::7]:
                where = xs[at % len(xs)], ys[at // len(xs) % len(ys)], zs[at // (len(xs) * len(ys))]
                free = geometry.clearance(kept.world, *where) >= 1.0
                assert (layer.state[at] == grid.FREE) == free
        for start, goal in trips(rng, kept.world, 12):
            one_way, other_way = kept.path(start, goal, 1.0), again.path(start, goal, 1.0)
            assert one_way is not None and other_way is not None
            np.testing.assert_array_equal(one_way, other_way)


def test_a_change_keeps_the_lattice_and_the_ways_it_does_not_touch() -> None:
    tower = Box(min=(-5, -5, 0), max=(5, 5, 30))
    there = StaticMap(world_of(scene(tower)))
    start, goal = np.array([-30.0, 0.0, 5.0]), np.array([30.0, 0.0, 5.0])
    before = there.path(start, goal, 1.0)
    (layer,) = there._layers.values()
    assert before is not None
    there.update(added=[Box(min=(-40, 30, 0), max=(-30, 40, 10))])
    assert list(there._layers.values()) == [layer] and len(there._paths) == 1
    np.testing.assert_array_equal(there.path(start, goal, 1.0), before)
    there.update(added=[Box(min=(-1, -20, 0), max=(1, 20, 30))])
    assert not there._paths
    wider = there.path(start, goal, 1.0)
    assert wider is not None and np.abs(wider[:, 1]).max() > 20.9


def test_what_is_gone_is_no_longer_gone_around() -> None:
    tower, wall = Box(min=(-5, -5, 0), max=(5, 5, 10)), Box(min=(10, -25, 0), max=(12, 25, 30))
    there = StaticMap(world_of(scene(tower, wall)))
    start, goal = np.array([-30.0, 0.0, 5.0]), np.array([30.0, 0.0, 5.0])
    around = there.path(start, goal, 1.0)
    assert around is not None and np.abs(around[:, 1]).max() > 25.9
    there.update(removed=[wall])
    past = there.path(start, goal, 1.0)
    assert past is not None and np.abs(past[:, 1]).max() < 10
    there.update(removed=[tower])
    straight = there.path(start, goal, 1.0)
    assert straight is not None and len(straight) == 2


def test_what_was_not_there_cannot_be_removed() -> None:
    tower = Box(min=(-5, -5, 0), max=(5, 5, 10))
    there = StaticMap(world_of(scene(tower)))
    with pytest.raises(ValueError):
        there.update(removed=[Box(min=(-5, -5, 0), max=(5, 5, 11))])
    assert len(there.world.solids) == 1


def test_a_way_that_is_handed_out_is_not_the_one_that_is_kept() -> None:
    there = StaticMap(world_of(scene(Box(min=(-5, -5, 0), max=(5, 5, 30)))))
    start, goal = np.array([-30.0, 0.0, 5.0]), np.array([30.0, 0.0, 5.0])
    first = there.path(start, goal, 1.0)
    assert first is not None
    first[1] = 0.0
    again = there.path(start, goal, 1.0)
    assert again is not None and not np.array_equal(first, again)


def walls(x: float) -> list[Obstacle]:
    """A closed cell about (x, 0)."""
    sides = [(x - 10, -10, 0, x - 9, 10, 12), (x + 9, -10, 0, x + 10, 10, 12), (x - 10, -10, 0, x + 10, -9, 12)]
    sides += [(x - 10, 9, 0, x + 10, 10, 12), (x - 10, -10, 12, x + 10, 10, 13)]
    return [Box(min=(a, b, c), max=(d, e, f)) for a, b, c, d, e, f in sides]


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
    there.update(removed=[obstacles[4]])  # the first cell's roof
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


def test_alternatives_pass_on_other_sides() -> None:
    world = world_of(scene(Box(min=(-5, -15, 0), max=(5, 15, 30))))
    there = StaticMap(world)
    start, goal = np.array([-30.0, 1.0, 5.0]), np.array([30.0, 1.0, 5.0])
    ways = there.alternatives(start, goal, 1.0, 3)
    assert len(ways) == 3
    assert ways[0][:, 1].max() > 15.9 and any(way[:, 1].min() < -15.9 for way in ways[1:])
    for way in ways:
        assert all(geometry.segment_clear(world, way[i], way[i + 1], 1.0) for i in range(len(way) - 1))


def test_a_change_of_a_prism_leaves_the_others_corners() -> None:
    prisms: list[Obstacle] = [
        NoFly(polygon=[(0, 0), (5, 0), (0, 5)], floor=0, ceiling=9),
        NoFly(polygon=[(20, 0), (25, 0), (25, 5), (20, 5)], floor=0, ceiling=9),
        NoFly(polygon=[(-20, 0), (-15, 0), (-20, 5)], floor=3, ceiling=9),
    ]
    world = changed(world_of(scene(*prisms)), removed=prisms[:1])
    for one, other in zip(world, world_of(scene(*prisms[1:])), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_way_is_missing_for_certain_or_for_lack_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A window that is too narrow by less than can be proven, and one that is wide enough but far off."""
    monkeypatch.setattr(staticmap, "PATIENCE", 0.0)
    scene = gapped(2.0 - 1e-6)
    problem, world = problem_of(scene), world_of(scene)
    with pytest.raises(PlanError) as caught:
        StaticMap(world).paths_for(problem, until=time.monotonic())
    assert (caught.value.kind, caught.value.ids) == ("timeout", ["a"])
    assert len(StaticMap(world_of(gapped(2.02))).paths_for(problem)) == 1  # with more time where that is needed
    monkeypatch.setattr(staticmap, "THOROUGH", 0.0)
    with pytest.raises(PlanError) as caught:
        StaticMap(world).paths_for(problem)
    assert (caught.value.kind, caught.value.ids) == ("unreachable", ["a"])
