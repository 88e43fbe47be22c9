"""Searches: everything is seen, everybody is done at the same time, nobody meets, nobody stays out too long."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from agents.planner.goals import search
from agents.planner.goals.dealing import Ground, Part, Sweeper
from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import FleetView, Fly, PlanTo
from agents.planner.model.scene import Box, Corner, Cylinder, Fence, NoFly, Obstacle
from tests.agents.planner.goals.team import balance, fly_all, ground, judge_fly, lasting, team, view
from zmav import wire
from zmav.errors import BadInput, Unsupported

SQUARE: list[Corner] = [(0.0, 0.0), (160.0, 0.0), (160.0, 160.0), (0.0, 160.0)]
ELL: list[Corner] = [(0.0, 0.0), (200.0, 0.0), (200.0, 80.0), (80.0, 80.0), (80.0, 200.0), (0.0, 200.0)]
HOLES: list[Obstacle] = [
    NoFly(polygon=[(60.0, 60.0), (100.0, 70.0), (90.0, 110.0), (50.0, 100.0)], floor=0.0, ceiling=60.0),
    Cylinder(center=(30.0, 130.0), radius=10.0, floor=0.0, ceiling=60.0),
    Box(min=(120.0, 20.0, 0.0), max=(140.0, 40.0, 60.0)),
]


def sweepers(count: int, endurance: float = 3000.0, mixed: bool = False) -> list[Sweeper]:
    return [
        Sweeper(
            name=f"v{i}",
            start=np.array([-30.0 - 5.0 * i, -20.0, 10.0]),
            height=20.0,
            width=10.0 * (1 + i % 3 * mixed),
            speed=5.0 + 3.0 * (i % 2 * mixed),
            accel=2.5,
            climb=2.0,
            endurance=endurance,
            radius=1.0,
        )
        for i in range(count)
    ]


def deal(polygon: list[Corner], count: int, holes: bool = False, **more: object) -> tuple[Ground, search.Split]:
    area = search.ground(polygon, ground(HOLES if holes else []), (20.0, 20.0), 1.0)
    course = more.pop("course", None)
    return area, search.split(area, sweepers(count, **more), 0.1, course)  # type: ignore[arg-type]


def seen_share(area: Ground, parts: tuple[Part, ...]) -> float:
    """By a thousand places picked at random, and their distances from the ways: not as the split reckons it."""
    rng = np.random.default_rng(7)
    low, high = np.array(area.wanted.bounds[:2]), np.array(area.wanted.bounds[2:])
    picked = rng.uniform(low, high, (3000, 2))
    inside = picked[shapely.contains_xy(area.wanted, picked[:, 0], picked[:, 1])]
    seen = np.zeros(len(inside), dtype=bool)
    for part in parts:
        away, _ = cKDTree(part.curve(area.free)[:, :2]).query(inside)
        seen |= away <= part.sweeper.width / 2.0 + 0.02
    return float(seen.mean())


@pytest.mark.parametrize(("count", "mixed"), [(1, False), (4, False), (5, True)])
@pytest.mark.parametrize(("polygon", "holes"), [(SQUARE, True), (ELL, False)])
def test_nearly_everything_is_seen_and_all_are_done_together(
    polygon: list[Corner], holes: bool, count: int, mixed: bool
) -> None:
    area, dealt = deal(polygon, count, holes, mixed=mixed)
    assert dealt.covered > 0.985
    assert seen_share(area, dealt.parts) > 0.98
    assert balance(dealt.parts) < 1.2
    together = shapely.union_all([part.area for part in dealt.parts])
    assert together.area == pytest.approx(area.wanted.area, rel=1e-3), "the parts make up the whole"
    assert sum(part.area.area for part in dealt.parts) == pytest.approx(area.wanted.area, rel=1e-3)
    for part in dealt.parts:
        curve = part.curve(area.free)
        assert area.free.buffer(search.SPARE / 2.0).covers(shapely.linestrings(curve[:, :2])), (
            "nobody flies through what stands there"
        )


def test_shares_go_by_width_times_speed() -> None:
    area = search.ground(SQUARE, ground(), (20.0, 20.0), 1.0)
    slow, fast = sweepers(2)
    fast = Sweeper(**{**fast.__dict__, "width": 20.0, "speed": 8.0, "start": slow.start})
    shares = [part.area.area for part in search.split(area, [slow, fast], 0.1, None).parts]
    assert shares[1] / shares[0] == pytest.approx(20.0 * 8.0 / (10.0 * 5.0), rel=0.35)


def test_lanes_run_as_asked_else_along_the_polygon() -> None:
    for asked in (0.3, None):
        turned = [
            (x * math.cos(0.7) - y * math.sin(0.7), x * math.sin(0.7) + y * math.cos(0.7))
            for x, y in [(0.0, 0.0), (200.0, 0.0), (200.0, 60.0), (0.0, 60.0)]
        ]
        _, dealt = deal(turned, 1, course=asked)
        steps = np.diff(dealt.parts[0].path[:, :2], axis=0)
        longest = steps[np.argmax(np.linalg.norm(steps, axis=1))]
        course = math.atan2(longest[1], longest[0]) % math.pi
        assert course == pytest.approx(0.7 if asked is None else asked, abs=0.01)


def test_who_cannot_stay_out_long_enough_sees_what_it_can_and_it_is_said() -> None:
    for endurance, least in ((170.0, 0.3), (200.0, 0.42), (330.0, 0.8)):
        _, dealt = deal(SQUARE, 2, endurance=endurance)
        assert least < dealt.covered < 0.9
        assert all(0.0 < part.seconds <= endurance for part in dealt.parts)
    assert "endurance suffices for" in dealt.text
    with pytest.raises(BadInput, match="endurance"):
        deal(SQUARE, 2, endurance=15.0)


@pytest.mark.parametrize(
    ("polygon", "field"),
    [
        ([(0.0, 0.0), (10.0, 0.0)], "polygon"),
        ([(0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)], "polygon"),
        ([(900.0, 900.0), (950.0, 900.0), (950.0, 950.0)], "polygon"),
        ([(122.0, 22.0), (138.0, 22.0), (138.0, 38.0)], "polygon"),
    ],
)
def test_a_polygon_that_cannot_be_searched_is_named(polygon: list[Corner], field: str) -> None:
    with pytest.raises(BadInput) as e:
        deal(polygon, 1, holes=True)
    assert e.value.detail["field"] == field


def test_a_height_outside_the_fence_and_a_bad_overlap_are_named() -> None:
    fence = Fence(polygon=SQUARE, floor=5.0, ceiling=15.0)
    with pytest.raises(BadInput, match="5 to 15 m"):
        search.ground(SQUARE, ground(fence=fence), (20.0, 20.0), 1.0)
    area = search.ground(SQUARE, ground(), (20.0, 20.0), 1.0)
    with pytest.raises(BadInput) as e:
        search.split(area, sweepers(1), 1.0, None)
    assert e.value.detail["field"] == "overlap"


def test_a_search_is_flown_on_one_clock_there_and_back() -> None:
    fleet, world = team(5), ground(HOLES)
    polygon = [(y, x) for x, y in SQUARE]
    goal = wire.swarm.Search(vehicles=list(fleet.vehicles), polygon=polygon, angle=0.0, height=20.0)
    steps = resolve(goal, fleet, world)
    there, lanes, back = steps
    assert isinstance(there, PlanTo) and isinstance(lanes, Fly) and isinstance(back, PlanTo)
    report = judge_fly(lanes, fleet, world)
    assert report.ok, report.faults[:3]
    assert fly_all(steps, fleet, world) < 1.5 * lasting(lanes)
    assert lanes.instead, "corner by corner where the clock cannot be kept"


def test_planes_are_left_out() -> None:
    fleet = FleetView({"c1": view("c1", (-20.0, -20.0, -10.0)), "p1": view("p1", (-60.0, -60.0, -40.0), "plane")})
    goal = wire.swarm.Search(vehicles=["c1", "p1"], polygon=[(y, x) for x, y in SQUARE], height=20.0)
    with pytest.raises(Unsupported, match="p1 cannot hover"):
        resolve(goal, fleet, ground())
