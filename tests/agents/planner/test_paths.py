"""Single ways: lattices, the search, shortening and OMPL."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest

from agents.planner.model import geometry
from agents.planner.model.deadline import Deadline
from agents.planner.model.problem import ROVER, Floats, Path
from agents.planner.model.scene import Bounds, Box, Corner, Fence, NoFly, Obstacle, Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.world import World, world_of
from agents.planner.solve.paths import lattice, sampled, shorten

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
ROOM: Corners = ((-60, -40, 0), (60, 40, 24))
LAND: Corners = ((-200, -200, 0), (200, 200, 120))
YARD: Corners = ((-30, -30, 0), (30, 30, 20))
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
        rough = rough[[geometry.away(there, x, y, z, 0.6, np.empty(3)) == 0.0 for x, y, z in rough]]
        legs = [geometry.segment_clear(there, a, b, 0.5) for a, b in itertools.pairwise(rough)]
        if len(rough) < 4 or not all(legs[:3]):
            continue
        tried += 1
        way = np.ascontiguousarray(rough[:4])
        short = assert_clear(there, shorten.shorten(there, way, 0.5, RATES, 8), way[0], way[-1], 0.5)
        assert shorten.travel_time(short, RATES) <= shorten.travel_time(way, RATES)


def test_a_lattice_has_a_point_in_every_gap() -> None:
    there = world(*gate(2.2))
    lines = lattice.lattice_of(there, 4.0, 1.0)
    assert np.isclose(lines.y, 3.7).any() and np.isclose(lines.z, 11.3).any()
    assert not np.isclose(lattice.lattice_of(there, 4.0, 1.2).y, 3.7).any()
    assert lattice.lattice_of(there, 4.0, 1.0, height=0.5).z.tolist() == [0.5]
    for line, low, high in zip(lines, *ROOM, strict=True):
        assert low < line[0] and line[-1] < high and (np.diff(line) > 0).all() and np.diff(line).max() <= 4.0 + 1e-9


def test_a_sampled_way_is_clear() -> None:
    there = world(Box(min=(-10, -10, 0), max=(10, 10, 24)))
    start, goal = point(-40, 0, 12), point(40, 0, 12)
    assert_clear(there, sampled.find(there, start, goal, 1.0, Deadline.after(5.0)), start, goal, 1.0)


def test_no_sampled_way_is_made_up() -> None:
    there = world(*cell(9, 12))
    assert sampled.find(there, point(40, 0, 10), point(1, 2, 5), 1.0, Deadline.after(0.1)) is None


def tent(slot: float) -> list[Obstacle]:
    """Four walls and a roof about the origin, aslant to every line of a lattice; one wall has a slot."""
    corners = np.array([(12.0, 0.0), (0.0, 12.0), (-12.0, 0.0), (0.0, -12.0), (12.0, 0.0)])
    middle, along = 0.7 * corners[0] + 0.3 * corners[1], slot / 2.0 * np.array([-1.0, 1.0]) / math.sqrt(2.0)
    sides = [(corners[0], middle - along), (middle + along, corners[1]), *itertools.pairwise(corners[1:])]
    rings: list[list[Corner]] = [[(x, y) for x, y in (a, b, 1.1 * b, 1.1 * a)] for a, b in sides]
    return [
        *(NoFly(polygon=ring, floor=0, ceiling=12) for ring in rings),
        Box(min=(-14, -14, 12), max=(14, 14, 13)),
    ]


@pytest.mark.parametrize("inside", [0, 1], ids=["start", "goal"])
@pytest.mark.parametrize(("size", "slots"), [(LAND, (2.3, 2.2, 1.9)), (YARD, (2.5, 2.2, 1.9))], ids=["land", "yard"])
def test_out_of_what_an_end_is_walled_in_by_or_at_once_no_way(
    inside: int, size: Corners, slots: tuple[float, ...]
) -> None:
    """A minute is given: there is little to look at from that end, whichever it is. The second slot is found only where
    one lattice more is tried than what half a radius asks for, or than the first, where that is as fine.
    """
    for slot in slots:
        there, until = world(*tent(slot), size=size), Deadline.after(60.0)
        ends = [point(1, 2, 0.5), point(size[1][0] - 3, 20, 0.5)][:: 1 if inside == 0 else -1]
        path = StaticMap(there).path(ends[0], ends[1], 1.0, ROVER, until=until)
        assert until.processor - time.thread_time() > 55.0
        if slot > 2.0:
            assert_clear(there, path, ends[0], ends[1], 1.0)
        else:
            assert path is None
