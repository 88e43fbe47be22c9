"""The ground as columns: none lower than its ground, finer beside places, and what is planned among them."""

from __future__ import annotations

import array
import math
import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from agents.planner.goals.drape import Drape
from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import Orders, PlanTo
from agents.planner.live.field import FleetField, check_field, field_of, floor_of, ground_of
from agents.planner.model.ground import LEAF, MOST, NAME, SPARE, UNKNOWN, Floor, GroundMap
from agents.planner.model.scene import Bounds, Box, Scene, Vehicle
from agents.planner.model.verify import verify
from agents.planner.solve.pipeline import solve
from tests.agents.planner.goals.team import team
from zmav import geo
from zmav.config import FleetConfig, Geofence, VehicleConfig
from zmav.errors import BadInput
from zmav.terrain import VOID, Piece, corner_of, names_within
from zmav.wire import Origin, swarm

ORIGIN = Origin(lat_deg=-35.3632, lon_deg=149.1652, alt_amsl=600.0)
Height = Callable[[float, float], float | None]
RADII = (1.0, 1.5)


def hill(x: float, y: float, at: tuple[float, float] = (200.0, 0.0), high: float = 80.0, wide: float = 90.0) -> float:
    """m above the sea."""
    return 600.0 + high * math.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / wide**2)


def ground_map(height: Height, reach: float = 600.0, side: int = 61) -> GroundMap:
    low, high = (geo.to_global(ORIGIN, (sign * reach, sign * reach, 0.0))[:2] for sign in (-1.0, 1.0))
    pieces = {}
    for name in names_within(*low, *high):
        south, west = corner_of(name)
        heights = array.array("h")
        for row in range(side):
            for column in range(side):
                lat, lon = (south + 1 - row / (side - 1)) / 60, (west + column / (side - 1)) / 60
                north, east, _ = geo.to_ned(ORIGIN, lat, lon, 0.0)
                found = height(east, north)
                heights.append(VOID if found is None else round(found))
        pieces[name] = Piece(side, heights)
    return GroundMap(pieces, ORIGIN)


def floor(ground: GroundMap, declared: float | None = 15.0, walls: bool = True) -> Floor:
    return Floor(ground, declared, 0.0, RADII, math.inf, walls)


BOUNDS = Bounds(min=(-100.0, -150.0, 0.0), max=(450.0, 150.0, 150.0))


@pytest.mark.parametrize("side", [61, 21, 7])
def test_no_column_is_lower_than_its_ground_and_what_is_asked(side: int) -> None:
    here = floor(ground_map(hill, side=side))
    columns = here.columns(BOUNDS, (), ())
    assert 0 < len(columns) <= MOST
    rng = random.Random(side)
    for _ in range(2000):
        x, y = rng.uniform(-100.0, 450.0), rng.uniform(-150.0, 150.0)
        up = here.up(x, y)
        assert up is not None
        top = max((c.max[2] for c in columns if c.min[0] <= x <= c.max[0] and c.min[1] <= y <= c.max[1]), default=-1e9)
        least = up + 15.0 + SPARE - RADII[0]
        assert top >= least - 1e-6 or least <= BOUNDS.min[2] - RADII[1] + 1.0, (x, y)
    assert all(c.name == NAME and c.min[2] < BOUNDS.min[2] for c in columns)


def test_columns_are_wider_where_there_would_be_too_many() -> None:
    wide = Bounds(min=(-2500.0, -2500.0, 0.0), max=(2500.0, 2500.0, 150.0))
    rough = floor(ground_map(lambda x, y: 640.0 + 30.0 * math.sin(x / 60.0) * math.cos(y / 70.0), 2600.0))
    columns = rough.columns(wide, (), ())
    assert MOST / 5 < len(columns) <= MOST
    assert min(c.max[0] - c.min[0] for c in columns) > 30.0


def test_what_is_known_beside_voids_is_ground_however_wide_its_columns_are() -> None:
    """... and no more than that: where no height is asked for, what is not known is no obstacle."""

    def height(x: float, y: float) -> float | None:
        return None if x % 700.0 < 80.0 and y % 900.0 < 80.0 else 640.0 + 30.0 * math.sin(x / 60.0) * math.cos(y / 70.0)

    here, wide = (
        floor(ground_map(height, 2600.0), None),
        Bounds(min=(-2500.0, -2500.0, 0.0), max=(2500.0, 2500.0, 150.0)),
    )
    rng = random.Random(2)
    places = [(rng.uniform(-2400.0, 2400.0), rng.uniform(-2400.0, 2400.0), 30.0) for _ in range(40)]
    columns = here.columns(wide, (), places)
    assert {c.name for c in columns} == {NAME}
    known = 0
    for _ in range(1000):
        x, y = rng.uniform(-2500.0, 2500.0), rng.uniform(-2500.0, 2500.0)
        up = here.up(x, y)
        if up is not None and min(math.dist((x, y), place[:2]) for place in places) > 60.0:
            top = max((c.max[2] for c in columns if c.min[0] <= x <= c.max[0] and c.min[1] <= y <= c.max[1]), default=0)
            known += 1
            assert top >= up + SPARE - RADII[0] - 1e-6, (x, y)
    assert known > 900


def test_the_edge_of_a_void_is_known() -> None:
    here = ground_map(lambda x, y: None if x > 300.0 else 600.0)
    edge = max(x for x in range(200, 320) if floor(here).up(float(x), 0.0) is not None)
    assert here.highest((100.0, -50.0, edge - 1.0, 50.0)) == 600.0
    assert here.highest((100.0, -50.0, edge + 40.0, 50.0)) is None


def test_beside_a_place_columns_are_narrow_and_let_one_climb_that_is_too_low() -> None:
    here = floor(ground_map(hill))
    start, goal = (150.0, 10.0, here.up(150.0, 10.0) or 0.0), (60.0, 0.0, 40.0)
    start = (start[0], start[1], start[2] + 3.0)
    plain, finer = here.columns(BOUNDS, (), ()), here.columns(BOUNDS, (start,), (goal,))
    assert len(finer) > len(plain)

    def free(columns: list[Box], place: tuple[float, float, float], radius: float) -> bool:
        x, y, z = place
        gaps = [
            max(c.min[0] - x, x - c.max[0], 0.0) ** 2
            + max(c.min[1] - y, y - c.max[1], 0.0) ** 2
            + max(c.min[2] - z, z - c.max[2], 0.0) ** 2
            for c in columns
        ]
        return bool(min(gaps) >= radius**2)

    assert not free(plain, start, RADII[1])
    assert free(finer, start, RADII[1])
    lowest = here.lowest(goal[0], goal[1])
    assert lowest is not None
    slope = 80.0 / 90.0 * math.sqrt(2.0 / math.e)
    assert lowest - (here.up(*goal[:2]) or 0.0) - 15.0 < SPARE + 0.5 + slope * 2.0 * (LEAF + RADII[1] + 1.0)
    rest = (goal[0], goal[1], lowest)
    assert free(here.columns(BOUNDS, (), (rest,)), rest, RADII[1])


def test_unknown_ground_is_a_wall_only_where_height_is_asked_for() -> None:
    half = ground_map(lambda x, y: None if x > 300.0 else hill(x, y))
    assert any(c.name == UNKNOWN for c in floor(half).columns(BOUNDS, (), ()))
    assert not any(c.name == UNKNOWN for c in floor(half, None).columns(BOUNDS, (), ()))
    assert floor(half).lowest(350.0, 0.0) is None
    nowhere = floor(GroundMap({}, ORIGIN))
    assert {c.name for c in nowhere.columns(BOUNDS, (), ())} == {UNKNOWN}
    assert floor(GroundMap({}, ORIGIN), None).columns(BOUNDS, (), ()) == []
    assert floor(ground_map(hill), walls=False).columns(BOUNDS, (), ()) == []
    with pytest.raises(BadInput, match="--terrain"):
        floor(half).span((0.0, 0.0, 400.0, 100.0))
    low, high = floor(half).span((0.0, -100.0, 250.0, 100.0))
    assert low < 2.0
    assert 70.0 < high < 81.0


@pytest.mark.parametrize("ceiling", [150.0, 70.0])
def test_ways_lead_over_the_hill_or_around_it(ceiling: float) -> None:
    """And the vehicle's own judge, who looks at the ground itself, has nothing against them."""
    here = floor(ground_map(hill))
    vehicles, starts, goals = [], [], []
    for i in range(3):
        start, goal = (0.0, 10.0 * i - 10.0, 25.0), (400.0, 10.0 * i - 10.0, 25.0)
        vehicles.append(
            Vehicle(id=f"v{i}", type="copter", start=start, goal=goal, radius=1.2, vmax=8.0, amax=2.5, vz_up=3.0)
        )
        starts.append(start)
        goals.append(goal)
    bounds = Bounds(min=BOUNDS.min, max=(*BOUNDS.max[:2], ceiling))
    columns = here.columns(bounds, starts, [*starts, *goals])
    scene = Scene(vehicles=vehicles, bounds=bounds, obstacles=[*columns], downwash=1.5)
    plan = solve(scene, seconds=20.0)
    assert plan.error is None
    assert verify(scene, plan.trajectories).ok
    for samples in plan.trajectories.values():
        least = here.check(samples, (0.0, 0.0, 0.0))
        assert least is not None
        assert least >= 15.0
        assert np.array(samples)[:, 3].max() <= ceiling
    straight = [(t / 10.0, 4.0 * t, 0.0, 60.0) for t in range(100)]
    with pytest.raises(BadInput, match=r"(above|under) the ground"):
        here.check(straight, None)


def test_a_planner_reads_the_ground_of_its_vehicles_fields_once() -> None:
    asked: list[str] = []

    class Source:
        def piece(self, name: str) -> Piece | None:
            asked.append(name)
            return Piece(2, array.array("h", [600] * 4))

    own = VehicleConfig(link="tcp:0", geofence=Geofence(radius=3000.0, above_ground=25.0))
    file = FleetConfig(fleet="demo", origin=ORIGIN, geofence=Geofence(radius=500.0), vehicles={"quad2": own})
    known = ground_of(file, Source())
    assert sorted(known.pieces) == sorted(asked)
    for reach in (-3100.0, 3100.0):
        place = geo.to_global(ORIGIN, (reach, reach, 0.0))
        assert known.height(*place[:2]) == 600.0
    field = field_of(file)
    assert (field.above_ground("quad1"), field.above_ground("quad2")) == (None, 25.0)
    assert field.asks_for_height
    with pytest.raises(BadInput, match=r"\[origin\]"):
        ground_of(FleetConfig(fleet="demo"), Source())
    with pytest.raises(BadInput, match="--file"):
        ground_of(None, Source())


def test_where_no_height_is_asked_for_places_may_be_low() -> None:
    """As vehicles have it: tiles may be wrong by 10 m."""
    here, rest = floor(ground_map(hill), None), (150.0, 10.0)
    up = here.up(*rest)
    assert up is not None
    assert here.lowest(*rest) == pytest.approx(up - 10.0)
    place = (*rest, up + 1.0)
    columns = here.columns(BOUNDS, (), (place,))
    over = [c.max[2] for c in columns if c.min[0] <= rest[0] <= c.max[0] and c.min[1] <= rest[1] <= c.max[1]]
    assert max(over) < place[2] - RADII[1]
    assert max(c.max[2] for c in columns) > 75.0, "the hill is one all the same"


def test_the_vehicle_s_home_says_what_the_ground_is_off() -> None:
    here = floor(ground_map(lambda x, y: 600.0))
    way = [(0.0, 0.0, 0.0, 40.0), (5.0, 40.0, 0.0, 40.0)]
    assert here.check(way, (0.0, 0.0, 0.0)) == pytest.approx(40.0)
    assert here.check(way, (0.0, 0.0, 12.0)) == pytest.approx(28.0)
    assert here.check(way, None) == pytest.approx(40.0)


@pytest.mark.parametrize("kind", ["return", "land"])
def test_landings_are_approached_high_enough_and_straight_down(kind: str) -> None:
    fleet = team(3, (0.0, 0.0, -30.0), 6.0)
    names = list(fleet.vehicles)
    here = floor(ground_map(hill))
    scene = Scene(vehicles=[], bounds=BOUNDS, obstacles=[*here.columns(BOUNDS, (), ())], downwash=1.5)
    goal = swarm.Return(vehicles=names) if kind == "return" else swarm.Land(vehicles=names)
    plain, high = (resolve(goal, fleet, scene, None, each) for each in (None, here))
    for steps, least in ((plain, 8.0), (high, 15.0)):
        there, orders = steps
        assert isinstance(there, PlanTo)
        assert isinstance(orders, Orders)
        assert orders.lands
        assert least <= there.places[:, 2].min() < least + 3.0, "the hill is far"


def test_what_moves_is_held_above_the_ground_by_its_vehicles_own_clearance() -> None:
    ground, view = ground_map(hill), team(2).pick(["v000", "v001"])
    field = FleetField(Geofence(), {"v001": Geofence(above_ground=20.0)}, ORIGIN)
    assert floor_of(field, None, view[:1]) is None
    nothing = floor_of(field, None, view[1:])
    assert nothing is not None
    assert nothing.lowest(0.0, 0.0) is None
    both, one = floor_of(field, ground, view), floor_of(field, ground, view[:1])
    assert both is not None
    assert one is not None
    assert (both.declared, one.declared) == (20.0, None)
    driving = replace(view[0], kind="rover", name="r")
    mixed = floor_of(field, ground, [driving, view[1]])
    assert mixed is not None
    assert not mixed.walls
    assert floor_of(field, ground, [driving]) is None
    low = swarm.GoTo(vehicles=["v000", "v001"], to=[(0.0, 0.0, -5.0), (0.0, 9.0, -5.0)])
    with pytest.raises(BadInput, match=r"goal.to\[1\]: 3\.9 m above the ground, where 20 m are asked for"):
        check_field(low, team(2), field, ground, 1.5, lambda name: None)
    with pytest.raises(BadInput, match=r"goal.to\[1\]: the ground there is not known here"):
        check_field(low, team(2), field, None, 1.5, lambda name: None)


def test_lanes_that_follow_the_ground_may_be_stopped_at_their_corners() -> None:
    here = floor(ground_map(hill))
    drape = Drape(15.0, here, [(0.0, -100.0), (300.0, -100.0), (300.0, 100.0), (0.0, 100.0)])
    corners = np.array([(0.0, 0.0, 0.0), (150.0, 0.0, 0.0), (250.0, 60.0, 0.0), (300.0, 0.0, 0.0)])
    for x, y, z in drape.over(corners, rests=True).tolist():
        up, lowest = here.up(x, y), here.lowest(x, y)
        assert up is not None
        assert lowest is not None
        assert z >= max(up + 15.0, lowest) - 1e-9
        columns = here.columns(BOUNDS, (), ((x, y, z),))
        beside = [c.max[2] for c in columns if c.min[0] <= x <= c.max[0] and c.min[1] <= y <= c.max[1]]
        assert z >= max(beside, default=-math.inf) + RADII[1] - 1e-6
