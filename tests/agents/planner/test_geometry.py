"""The geometry of the static world, against shapely and against itself along finely sampled lines."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from agents.planner.model import geometry
from agents.planner.model.geometry import World, world_of
from agents.planner.model.problem import Floats
from agents.planner.model.scene import Bounds, Box, Corner, Cylinder, Fence, NoFly, Obstacle, Scene

STAR: list[Corner] = [(0, 12), (3, 3), (12, 0), (3, -3), (0, -12), (-3, -3), (-12, 0), (-3, 3)]
ELL: list[Corner] = [(-55, -55), (55, -55), (55, -15), (-15, -15), (-15, 55), (-55, 55), (-55, -55)]


def scene(*obstacles: Obstacle, fence: Fence | None = None) -> Scene:
    bounds = Bounds(min=(-60, -60, 0), max=(60, 60, 40))
    return Scene(vehicles=[], obstacles=list(obstacles), bounds=bounds, geofence=fence)


def anything(rng: np.random.Generator, count: int, polygon: list[Corner] = STAR) -> list[Obstacle]:
    """Boxes, cylinders and prisms, on the ground or above it."""
    made: list[Obstacle] = []
    for kind in rng.integers(3, size=count):
        x, y = (float(v) for v in rng.uniform(-62, 62, 2))
        floor, size, tall = (float(v) for v in rng.uniform((0, 1, 1), (25, 9, 15)))
        if kind == 0:
            made.append(Box(min=(x, y, floor), max=(x + size, y + tall, floor + tall)))
        elif kind == 1:
            made.append(Cylinder(center=(x, y), radius=size, floor=floor, ceiling=floor + tall))
        else:
            corners = [(x + u * size / 9, y + v * size / 9) for u, v in polygon]
            made.append(NoFly(polygon=corners, floor=floor, ceiling=floor + tall))
    return made


def distance_to(obstacle: Obstacle, points: Floats) -> Floats:
    """Metres from (N, 3) points to the nearest of an obstacle, 0 inside: by shapely, a circle with many corners."""
    if isinstance(obstacle, Cylinder):
        flat = np.maximum(np.hypot(*(points[:, :2] - obstacle.center).T) - obstacle.radius, 0.0)
        floor, ceiling = obstacle.floor, obstacle.ceiling
    else:
        if isinstance(obstacle, Box):
            shape = shapely.box(*obstacle.min[:2], *obstacle.max[:2])
            floor, ceiling = obstacle.min[2], obstacle.max[2]
        else:
            shape = shapely.Polygon(obstacle.polygon)
            floor, ceiling = obstacle.floor, obstacle.ceiling
        flat = shapely.distance(shape, shapely.points(points[:, :2]))
    height = np.maximum(np.maximum(floor - points[:, 2], points[:, 2] - ceiling), 0.0)
    distance: Floats = np.hypot(flat, height)
    return distance


def line(start: Floats, end: Floats, count: int = 300) -> Floats:
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


@pytest.mark.parametrize("count", [0, 1, 5, 60])
def test_a_points_distance_is_the_least_over_all_obstacles(count: int) -> None:
    rng = np.random.default_rng(count)
    obstacles = anything(rng, count)
    world = world_of(scene(*obstacles))
    points = rng.uniform((-60, -60, 0), (60, 60, 40), (400, 3))
    expected = np.min([np.full(400, np.inf), *(distance_to(o, points) for o in obstacles)], axis=0)
    depths = np.array([geometry.away(world, x, y, z, 9.0, np.empty(3)) for x, y, z in points])
    beside = expected > 0.0
    np.testing.assert_allclose(depths[beside], np.maximum(9.0 - expected, 0.0)[beside], atol=1e-9)
    assert (depths[~beside] >= 9.0).all()


@pytest.mark.parametrize(("count", "radius"), [(1, 0.3), (6, 1.0), (25, 1.0), (25, 3.0)])
def test_a_segment_is_clear_where_each_of_its_points_is(count: int, radius: float) -> None:
    rng = np.random.default_rng(count)
    verdicts = []
    for _ in range(8):
        obstacles = anything(rng, count)
        world = world_of(scene(*obstacles))
        ends = []
        for _ in range(25):
            e = world.solids[rng.integers(count)]
            near, way = rng.uniform(e[:3] - 3.0, e[3:6] + 3.0), rng.normal(0.0, rng.choice([1.0, 10.0]), 3)
            ends.append(np.clip([near - way, near + rng.uniform(0, 1) * way], (-60, -60, 0), (60, 60, 40)))
        lines = np.array([line(start, end) for start, end in ends])
        away = np.min([distance_to(o, lines.reshape(-1, 3)) for o in obstacles], axis=0).reshape(lines.shape[:2])
        for (start, end), least in zip(ends, away.min(axis=1), strict=True):
            step = math.dist(start, end) / (lines.shape[1] - 1)
            verdict = geometry.segment_clear(world, start, end, radius)
            verdicts.append(verdict)
            if least < radius:
                assert not verdict, (obstacles, start, end)
            elif least - step / 2 > radius:
                assert verdict, (obstacles, start, end)
    assert 0.1 < np.mean(verdicts) < 0.9


@pytest.mark.parametrize("kind", ["box", "cylinder", "no_fly"])
def test_the_nearest_point_decides_to_a_micrometre(kind: str) -> None:
    """A line that passes one edge of the obstacle's roof between its own ends."""
    obstacle: Obstacle
    if kind == "box":
        obstacle = Box(min=(-5, -5, 0), max=(5, 5, 10))
    elif kind == "cylinder":
        obstacle = Cylinder(center=(0, 0), radius=5, floor=0, ceiling=10)
    else:
        obstacle = NoFly(polygon=[(-5, -5), (5, -5), (5, 5), (-5, 5)], floor=0, ceiling=10)
    world = world_of(scene(obstacle))
    slope = np.array([-1.0, 0.0, 1.0]) / math.sqrt(2)  # across the edge x = 5, z = 10, and away from it both ways
    for keep, clear in ((2.0 + 1e-6, True), (2.0 - 1e-6, False)):
        near = np.array([5.0, 0.0, 10.0]) + keep * np.array([1.0, 0.0, 1.0]) / math.sqrt(2)
        assert geometry.segment_clear(world, near - 9.0 * slope, near + 7.0 * slope, 2.0) is clear
        assert geometry.segment_clear(world, near + 7.0 * slope, near - 9.0 * slope, 2.0) is clear


def test_a_prism_is_not_flown_through_from_top_to_bottom() -> None:
    world = world_of(scene(NoFly(polygon=[(-30, -30), (30, -30), (30, 30), (-30, 30)], floor=15, ceiling=16)))
    top, bottom = np.array([3.0, 4.0, 35.0]), np.array([3.0, 5.0, 2.0])
    assert not geometry.segment_clear(world, top, bottom, 0.5)
    assert geometry.segment_clear(world, top, np.array([20.0, 20.0, 17.0]), 0.5)


def test_the_fences_inner_corner_is_not_cut() -> None:
    world = world_of(scene(fence=Fence(polygon=ELL, floor=2, ceiling=35)))
    one, other = np.array([48.0, -25.0, 10.0]), np.array([-25.0, 48.0, 10.0])
    corner = np.array([-15.0, -15.0, 10.0])
    assert not geometry.segment_clear(world, one, other, 1.0)
    assert geometry.segment_clear(world, one, corner, 1.0) and geometry.segment_clear(world, corner, other, 1.0)
    # Along the rim is inside; below the floor and past the ceiling is not.
    assert geometry.segment_clear(world, np.array([55.0, -15.0, 9.0]), np.array([-15.0, -15.0, 9.0]), 1.0)
    assert not geometry.segment_clear(world, one, np.array([48.0, -25.0, 1.9]), 1.0)
    assert not geometry.segment_clear(world, one, np.array([48.0, -25.0, 35.1]), 1.0)


def test_a_fence_is_left_for_an_instant_only_where_shapely_says_so() -> None:
    rng = np.random.default_rng(3)
    ring = [(float(c[0]) * 4, float(c[1]) * 4) for c in STAR]
    world = world_of(scene(fence=Fence(polygon=ring, floor=0, ceiling=40)))
    shape = shapely.Polygon(ring)
    verdicts = []
    for start, end in rng.uniform((-30, -30, 5), (30, 30, 35), (400, 2, 3)):
        verdicts.append(geometry.segment_clear(world, start, end, 0.5))
        assert verdicts[-1] == shape.covers(shapely.LineString([start[:2], end[:2]]))
    assert 5 < sum(verdicts) < 200


def test_outside_says_how_far() -> None:
    world = world_of(scene(fence=Fence(polygon=ELL, floor=2, ceiling=35)))
    assert geometry.outside(world, 0.0, -20.0, 10.0) == 0.0
    assert geometry.outside(world, 0.0, -11.0, 10.0) == pytest.approx(4.0)
    assert geometry.outside(world, -12.0, -11.0, 10.0) == pytest.approx(3.0)
    assert geometry.outside(world, 0.0, -20.0, 0.5) == pytest.approx(1.5)
    assert geometry.outside(world, 63.0, -20.0, 10.0) == pytest.approx(8.0)


def escape(world: World, point: Floats, radius: float) -> tuple[float, Floats]:
    out = np.zeros(3)
    return geometry.away(world, point[0], point[1], point[2], radius, out), out


def test_a_step_the_way_out_ends_what_is_violated() -> None:  # of shapes without notches
    rng = np.random.default_rng(8)
    found = 0
    for trial in range(150):
        obstacles = anything(rng, 1, polygon=STAR[::2])
        world = world_of(scene(*obstacles))
        low, high = world.solids[0, :3] - 1.5, world.solids[0, 3:6] + 1.5
        point = rng.uniform(np.maximum(low, (-58, -58, 2)), np.maximum(np.minimum(high, (58, 58, 38)), (-57, -57, 3)))
        depth, way = escape(world, point, 1.0)
        if depth == 0.0:
            assert (way == 0.0).all() and distance_to(obstacles[0], point[None])[0] >= 1.0
            continue
        found += 1
        assert math.hypot(*way) == pytest.approx(1.0)
        after = point + (depth + 1e-9) * way
        assert distance_to(obstacles[0], after[None])[0] >= 1.0 - 1e-6, (trial, obstacles, point)
        shallow = point + (depth - 1e-3) * way
        assert distance_to(obstacles[0], shallow[None])[0] < 1.0
    assert found > 30


def test_the_way_out_of_a_house_does_not_go_down_through_the_ground() -> None:
    world = world_of(scene(Box(min=(-20, -20, 0), max=(20, 20, 30))))
    depth, way = escape(world, np.array([1.0, 0.0, 2.0]), 1.0)
    assert depth == pytest.approx(20.0) and way.tolist() == [1.0, 0.0, 0.0]
    depth, way = escape(world, np.array([1.0, 0.0, -2.0]), 1.0)
    assert depth > 0.0 and way[2] >= 0.0


def test_back_into_the_bounds() -> None:
    depth, way = escape(world_of(scene()), np.array([63.0, 0.0, -4.0]), 1.0)
    assert depth == pytest.approx(5.0)
    np.testing.assert_allclose(way, [-0.6, 0.0, 0.8])
