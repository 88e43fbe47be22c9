"""Single ways: lattices, the search, shortening, OMPL, and proofs that there is no way."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from agents.planner.model import geometry
from agents.planner.model.problem import ROVER, Floats, Path
from agents.planner.model.scene import Bounds, Box, Fence, NoFly, Obstacle, Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import World, world_of
from agents.planner.solve.paths import enclosed, lattice, sampled, shorten

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
ROOM: Corners = ((-60, -40, 0), (60, 40, 24))
LAND: Corners = ((-200, -200, 0), (200, 200, 120))
RATES = np.array([5.0, 5.0, 5.0])


def world(*obstacles: Obstacle, size: Corners = ROOM, fence: Fence | None = None) -> World:
    bounds = Bounds(min=size[0], max=size[1])
    return world_of(Scene(vehicles=[], obstacles=list(obstacles), bounds=bounds, geofence=fence))


def gate(width: float, size: Corners = ROOM, y: float = 3.7, z: float = 11.3) -> list[Obstacle]:
    """A wall across x = 0 with a square window."""
    (_, south, low), (_, north, high) = size
    half = width / 2
    return [
        Box(min=(-1, south, low), max=(1, y - half, high)),
        Box(min=(-1, y + half, low), max=(1, north, high)),
        Box(min=(-1, y - half, low), max=(1, y + half, z - half)),
        Box(min=(-1, y - half, z + half), max=(1, y + half, high)),
    ]


def cell(half: float, height: float, wall: float = 1.0) -> list[Obstacle]:
    """Four walls and a roof about the origin."""
    outer = half + wall
    return [
        Box(min=(-outer, -outer, 0), max=(-half, outer, height)),
        Box(min=(half, -outer, 0), max=(outer, outer, height)),
        Box(min=(-outer, -outer, 0), max=(outer, -half, height)),
        Box(min=(-outer, half, 0), max=(outer, outer, height)),
        Box(min=(-outer, -outer, height), max=(outer, outer, height + wall)),
    ]


def point(*at: float) -> Floats:
    return np.array(at, dtype=np.float64)


def length(path: Path) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def assert_clear(there: World, path: Path | None, start: Floats, goal: Floats, radius: float) -> Path:
    assert path is not None
    assert (path[0] == start).all() and (path[-1] == goal).all()
    assert all(geometry.segment_clear(there, a, b, radius) for a, b in itertools.pairwise(path))
    return path


@pytest.mark.parametrize(("size", "spare"), [(ROOM, 3.0), (ROOM, 0.05), (LAND, 0.3)])
def test_a_window_is_found_however_narrow(size: Corners, spare: float) -> None:
    there = world(*gate(2.0 + spare, size), size=size)
    start, goal = point(-40, -30, 5), point(50, 20, 20)
    path = assert_clear(there, StaticMap(there).path(start, goal, 1.0), start, goal, 1.0)
    through = math.dist(start, (0, 3.7, 11.3)) + math.dist((0, 3.7, 11.3), goal)
    assert length(path) < 1.03 * through


def test_a_slanted_slot_in_a_large_land_is_found() -> None:
    turn = math.radians(31)
    along, across = point(math.cos(turn), math.sin(turn)), point(-math.sin(turn), math.cos(turn))

    def wall(begin: float, end: float) -> NoFly:
        ring = [u * along + v * across for u, v in ((begin, -1), (end, -1), (end, 1), (begin, 1))]
        return NoFly(polygon=[(float(x), float(y)) for x, y in ring], floor=0, ceiling=120)

    there = world(wall(-400, 17.0), wall(19.6, 400), size=LAND)
    start, goal = point(100, -150, 60), point(-100, 150, 60)
    assert_clear(there, StaticMap(there).path(start, goal, 1.0, patience=60.0), start, goal, 1.0)


def test_round_a_tower_by_the_shortest_way() -> None:
    there = world(Box(min=(-10, -10, 0), max=(10, 10, 24)))
    start, goal = point(-40, 0, 12), point(40, 0, 12)
    path = assert_clear(there, StaticMap(there).path(start, goal, 1.0), start, goal, 1.0)
    # Two tangents to circles about the corners, two arcs, and the side between them.
    lead = math.sqrt(30**2 + 10**2 - 1)
    turned = math.atan2(10, 30) + math.atan2(1, lead)
    assert 2 * lead + 20 + 2 * turned <= length(path) < 1.01 * (2 * lead + 20 + 2 * turned)


def test_a_slow_climber_goes_round_and_a_quick_one_over() -> None:
    there = world(Box(min=(-2, -30, 0), max=(2, 30, 15)))
    start, goal = point(-20, 0, 8), point(20, 0, 8)
    quick = StaticMap(there).path(start, goal, 1.0, rates=(5.0, 5.0, 5.0))
    slow = StaticMap(there).path(start, goal, 1.0, rates=(5.0, 0.5, 0.5))
    assert quick is not None and quick[:, 2].max() > 15.9 and np.abs(quick[:, 1]).max() < 10
    assert slow is not None and slow[:, 2].max() < 12 and np.abs(slow[:, 1]).max() > 30


def test_a_rover_stays_on_the_ground() -> None:
    there = world(Box(min=(-2, -20, 0), max=(2, 30, 5)), Box(min=(5, -40, 3), max=(8, 40, 9)))
    start, goal = point(-20, 0, 0.5), point(20, 0, 0.5)
    path = assert_clear(there, StaticMap(there).path(start, goal, 0.7, ROVER), start, goal, 0.7)
    assert (path[:, 2] == 0.5).all()
    assert path[:, 1].min() < -20  # round the first, and below the second, which is in the air


def test_the_fence_is_kept() -> None:
    ring = [(-55.0, -35.0), (55.0, -35.0), (55.0, 0.0), (0.0, 0.0), (0.0, 35.0), (-55.0, 35.0)]
    there = world(fence=Fence(polygon=ring, floor=1, ceiling=20))
    start, goal = point(50, -5, 5), point(-5, 30, 5)
    path = assert_clear(there, StaticMap(there).path(start, goal, 1.0), start, goal, 1.0)
    assert length(path) < 1.01 * (math.dist(start, (0, 0, 5)) + math.dist((0, 0, 5), goal))


def test_room_to_spare_where_there_is_some() -> None:
    start, goal = point(-40, 0, 12), point(40, 0, 12)
    tower = world(Box(min=(-10, -10, 0), max=(10, 10, 24)))
    assert_clear(tower, StaticMap(tower).path(start, goal, 1.0, room=0.5), start, goal, 1.5 - 1e-9)
    narrow = world(*gate(2.6))
    assert_clear(narrow, StaticMap(narrow).path(start, goal, 1.0, room=0.5), start, goal, 1.0)


def test_no_long_way_round_for_room() -> None:
    start, goal = point(-20, 0, 12), point(20, 3, 12)
    walls = [Box(min=(-1, -1.2 - south, 0), max=(1, -1.2, 24)) for south in (20.0, 5.0)]
    for wall, squeezed in zip(walls, (True, False), strict=True):
        there = world(Box(min=(-1, 1.2, 0), max=(1, 40, 24)), wall)
        path = assert_clear(there, StaticMap(there).path(start, goal, 1.0, room=0.3), start, goal, 1.0)
        middle = np.interp(0.0, path[:, 0], path[:, 1])
        assert abs(middle) < 0.21 if squeezed else middle < -7.1


def test_shortening_keeps_clear_and_never_lengthens() -> None:
    rng = np.random.default_rng(2)
    low, size = rng.uniform((-50, -30, 0), (40, 20, 10), (25, 3)), rng.uniform(3, 9, (25, 3))
    there = world(*(Box(min=tuple(a), max=tuple(a + b)) for a, b in zip(low.tolist(), size, strict=True)))
    tried = 0
    while tried < 15:
        rough = rng.uniform(ROOM[0], ROOM[1], (9, 3))
        rough = rough[[geometry.clearance(there, *p) > 0.6 for p in rough]]
        legs = [geometry.segment_clear(there, a, b, 0.5) for a, b in itertools.pairwise(rough)]
        if len(rough) < 4 or not all(legs[:3]):
            continue
        tried += 1
        way = np.ascontiguousarray(rough[:4])
        short = assert_clear(there, shorten.shorten(there, way, 0.5, RATES, 8), way[0], way[-1], 0.5)
        assert shorten.travel_time(short, RATES) <= shorten.travel_time(way, RATES)


def pocket(there: World, start: Floats, goal: Floats, radius: float, **more: float) -> enclosed.Pocket | None:
    """The proof that there is no way; where there is none, it must have found a way."""
    found = enclosed.decide(there, radius, start, goal, 60.0, **more)
    if isinstance(found, enclosed.Pocket):
        return found
    assert_clear(there, found, start, goal, radius)
    return None


def test_there_is_no_way_out_of_a_cell() -> None:
    there = world(*cell(9, 12))
    inside, beyond = point(1, 2, 5), point(40, 0, 10)
    found = pocket(there, beyond, inside, 1.0)
    assert found is not None
    # Whichever flood ran dry: it was at its own end, and not at the other.
    assert found.holds(there, 1.0, inside) != found.holds(there, 1.0, beyond)
    assert found.holds(there, 1.0, inside) == found.holds(there, 1.0, point(-3, -4, 7))
    assert pocket(there, point(-40, 0, 10), beyond, 1.0) is None
    assert pocket(there, inside, point(-3, -4, 7), 1.0) is None


@pytest.mark.parametrize("width", [1.0, 1.9])
def test_there_is_no_way_through_a_window_that_is_too_narrow(width: float) -> None:
    assert pocket(world(*gate(width)), point(-20, 0, 10), point(20, 0, 10), 1.0) is not None


def test_nothing_is_proven_where_there_is_a_way() -> None:
    start, goal = point(-20, 0, 10), point(20, 0, 10)
    for width in (2.05, 5.0):
        assert pocket(world(*gate(width)), start, goal, 1.0) is None
    walls = cell(9, 12)[:4]  # no roof
    assert pocket(world(*walls), start, point(0, 0, 5), 1.0) is None


def test_what_stays_on_the_ground_is_walled_in_by_what_others_fly_over() -> None:
    there = world(*cell(9, 4)[:4])
    start, goal = point(-40, 0, 0.5), point(0, 0, 0.5)
    assert pocket(there, start, goal, 0.7) is None
    assert pocket(there, start, goal, 0.7, height=0.5) is not None


def test_a_fence_may_leave_no_way() -> None:
    ring = [(-55.0, -35.0), (55.0, -35.0), (55.0, 0.0), (0.0, 0.0), (0.0, 35.0), (-55.0, 35.0)]
    cut = NoFly(polygon=[(-1, 1), (1, -1), (-56, -38), (-58, -36)], floor=0, ceiling=24)
    fence = Fence(polygon=ring, floor=1, ceiling=20)
    start, goal = point(50, -5, 5), point(-5, 30, 5)
    assert pocket(world(cut, fence=fence), start, goal, 1.0) is not None
    assert pocket(world(cut), start, goal, 1.0) is None


def test_a_lattice_has_a_point_in_every_gap() -> None:
    there = world(*gate(2.2))
    lines = lattice.lattice_of(there, 4.0, 1.0)
    assert np.isclose(lines.y, 3.7).any() and np.isclose(lines.z, 11.3).any()
    assert not np.isclose(lattice.lattice_of(there, 4.0, 1.2).y, 3.7).any()
    assert lattice.lattice_of(there, 4.0, 1.0, height=0.5).z.tolist() == [0.5]
    for line, low, high in zip(lines, *ROOM, strict=True):
        assert low < line[0] and line[-1] < high and (np.diff(line) > 0).all() and np.diff(line).max() <= 4.0 + 1e-9


@pytest.mark.parametrize("planner", ["connect", "informed"])
def test_a_sampled_way_is_clear(planner: str) -> None:
    there = world(Box(min=(-10, -10, 0), max=(10, 10, 24)))
    start, goal = point(-40, 0, 12), point(40, 0, 12)
    seconds = 5.0 if planner == "connect" else 0.1
    path = sampled.find(there, start, goal, 1.0, seconds, "connect" if planner == "connect" else "informed")
    assert_clear(there, path, start, goal, 1.0)


def test_no_sampled_way_is_made_up() -> None:
    there = world(*cell(9, 12))
    assert sampled.find(there, point(40, 0, 10), point(1, 2, 5), 1.0, 0.1) is None
