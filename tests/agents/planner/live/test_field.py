"""A goal with a place outside the field is refused when it is given: under the ground, too high, too far."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import replace

import pytest

from agents.planner.goals.steps import FleetView, VehicleView
from agents.planner.live.checks import check_goal
from agents.planner.live.field import FleetField, check_field, field_of
from zmav.config import FleetConfig, Geofence, VehicleConfig, body_of
from zmav.errors import BadInput
from zmav.wire import Origin, Vector, swarm

NAMES = ["quad1", "quad2", "quad3"]
COUNT = 120


def fleet(ground: float = 0.0) -> FleetView:
    """Three copters in the air over a ground so many metres above the origin, and a rover on it."""
    views = {
        name: VehicleView(
            name,
            "copter",
            body_of("copter"),
            (0.0, 5.0 * i, -ground - 10.0),
            airborne=True,
            home_ned=(0.0, 5.0 * i, -ground),
        )
        for i, name in enumerate(NAMES)
    }
    views["rover1"] = VehicleView("rover1", "rover", body_of("rover"), (20.0, 0.0, -ground))
    return FleetView(views)


BALLS: dict[str, Vector] = {"cart": (30.0, 0.0, -2.0), "far_cart": (9000.0, 0.0, -20.0)}
"""obstacles that move"""


def held(
    goal: swarm.Goal,
    there: FleetView | None = None,
    declared: Geofence | None = None,
    own: Mapping[str, Geofence] | None = None,
    origin: Origin | None = None,
) -> None:
    field = FleetField(declared or Geofence(), own or {}, origin)
    check_field(goal, there or fleet(), field, None, 1.5, BALLS.get)


def _bad_place(r: random.Random) -> Vector:
    kind = r.choice(["under", "high", "far", "nan"])
    north, east, up = r.uniform(-50, 50), r.uniform(-50, 50), r.uniform(5, 30)
    if kind == "under":
        up = -r.choice([0.5, 20.0, 300.0])
    elif kind == "high":
        up = r.choice([121.0, 400.0, 9000.0])
    elif kind == "far":
        away, course = r.choice([1001.0, 5000.0, 99_000.0]), r.uniform(0, math.tau)
        north, east = away * math.cos(course), away * math.sin(course)
    else:
        north = r.choice([math.nan, math.inf, -math.inf, 1e30])
    return (north, east, -up)


def _bad_follows(r: random.Random) -> list[swarm.Goal]:
    """Bad by one follower's place, wherever it comes from."""
    up, far = (-6.0, 0.0, -10.0), (r.choice([-2000.0, 2000.0]), 0.0, -10.0)
    return [
        swarm.Follow(vehicles=NAMES[:1], leader="rover1", offsets=[far]),
        swarm.Follow(vehicles=NAMES[:2], leader="rover1", offsets=[up, (-9.0, 0.0, r.choice([12.0, -150.0]))]),
        swarm.Follow(vehicles=NAMES[:1], leader="cart", offsets=[(-6.0, 0.0, r.choice([4.0, -140.0]))]),
        swarm.Follow(vehicles=NAMES[:1], leader="far_cart"),
        swarm.Follow(vehicles=NAMES, leader="rover1"),
    ]


def _bad_goal(r: random.Random) -> swarm.Goal:
    bad, good = _bad_place(r), (10.0, 0.0, -20.0)
    places = [good, bad, good]
    r.shuffle(places)
    makers: list[swarm.Goal] = [
        swarm.GoTo(vehicles=NAMES, to=places, labelled=r.random() < 0.5),
        swarm.Formation(vehicles=NAMES, shape=r.choice(["line", "vee", "circle", "grid"]), at=bad, spacing=5.0),
        swarm.Formation(vehicles=NAMES, shape="line", at=good, via=[bad]),
        swarm.Formation(
            vehicles=NAMES,
            shape="custom",
            at=good,
            points=[(0.0, 0.0, 0.0), (0.0, 9.0, 0.0), (9.0, 0.0, r.choice([25.0, -120.0]))],
        ),
        swarm.Search(
            vehicles=NAMES, polygon=[(0.0, 0.0), (50.0, 0.0), (50.0, 50.0)], height=r.choice([-10.0, 130.0, math.nan])
        ),
        swarm.Search(vehicles=NAMES, polygon=[(0.0, 0.0), (5000.0, 0.0), (50.0, 50.0)], height=20.0),
        swarm.TakeOff(vehicles=NAMES, height=r.choice([-5.0, 0.0, 121.0, math.inf])),
        swarm.Follow(vehicles=NAMES[:1], leader="rover1", offsets=[(-5.0, 0.0, r.choice([8.0, 0.5, -125.0]))]),
        swarm.Land(vehicles=NAMES, at=[(0.0, 0.0), (0.0, 9.0), (4000.0, 0.0)]),
        *_bad_follows(r),
    ]
    return r.choice(makers)


def test_a_hundred_and_twenty_nonsense_goals_are_refused() -> None:
    """With the eighty that a vehicle refuses for itself and more: tests/services/authority/test_bounds.py."""
    r, taken = random.Random(20261123), []
    for _ in range(COUNT):
        goal = _bad_goal(r)
        try:
            check_goal(goal)
            held(goal)
        except BadInput as e:
            assert e.detail["field"]
        else:
            taken.append(goal)
    assert taken == []


@pytest.mark.parametrize("ground", [0.0, 250.0, -80.0])
def test_heights_count_from_the_vehicles_homes(ground: float) -> None:
    there = fleet(ground)
    good = swarm.Formation(vehicles=NAMES, shape="vee", at=(50.0, 0.0, -ground - 20.0))
    held(good, there)
    low = swarm.Formation(vehicles=NAMES, shape="vee", at=(50.0, 0.0, -ground + 20.0))
    with pytest.raises(BadInput, match=r"goal\.at: for quad1, 20\.0 m under the ground at home"):
        held(low, there)


def test_a_rover_s_height_means_nothing_and_a_declared_field_is_the_fleet_file_s() -> None:
    held(swarm.GoTo(vehicles=["rover1"], to=[(30.0, 0.0, 40.0)]))
    far = swarm.GoTo(vehicles=NAMES[:1], to=[(3000.0, 0.0, -300.0)])
    with pytest.raises(BadInput, match=r"2000\.0 m beyond the geofence's radius of 1000 m; .*\[geofence\]"):
        held(far)
    held(far, declared=Geofence(radius=4000.0, ceiling=400.0))
    valley = swarm.GoTo(vehicles=NAMES[:1], to=[(100.0, 0.0, 30.0)])
    held(valley, declared=Geofence(floor=-40.0))
    with pytest.raises(BadInput, match="under the floor of -20 m"):
        held(valley, declared=Geofence(floor=-20.0))


GOOD_FOLLOWS = [
    swarm.Follow(vehicles=NAMES[:1], leader="rover1", offsets=[(-5.0, 0.0, -10.0)]),
    swarm.Follow(vehicles=NAMES[:1], leader="rover1", offsets=[(970.0, 0.0, -10.0)]),
    swarm.Follow(vehicles=NAMES[1:], leader="quad1"),
    swarm.Follow(vehicles=NAMES[:1], leader="cart", offsets=[(-5.0, 0.0, 1.5)]),
    swarm.Follow(vehicles=NAMES[:1], leader="not_heard_yet"),
    swarm.Follow(vehicles=["rover1"], leader="quad1"),
    swarm.Search(vehicles=NAMES, polygon=[(0.0, 0.0), (50.0, 0.0), (50.0, 50.0)], height=20.0),
]


@pytest.mark.parametrize("goal", GOOD_FOLLOWS)
def test_what_is_flown_in_the_field_is_taken(goal: swarm.Goal) -> None:
    held(goal)


def test_who_would_follow_a_rover_on_the_ground_hears_that_offsets_are_wanted() -> None:
    """The usual places are at the leader's height, and that is what is flown."""
    with pytest.raises(BadInput, match="quad1 would be no higher than rover1, which is on the ground: give offsets"):
        held(swarm.Follow(vehicles=NAMES[:1], leader="rover1"))


def test_where_the_ground_is_not_known_a_copter_in_the_air_may_go_lower() -> None:
    seen = fleet().vehicles["quad1"]
    unknown = FleetView({"quad1": replace(seen, home_ned=None)})
    lower = swarm.GoTo(vehicles=["quad1"], to=[(10.0, 0.0, -4.0)])
    held(lower, unknown)
    held(lower, unknown, Geofence(floor=2.0))
    with pytest.raises(BadInput, match="over the ceiling of 120 m"):
        held(swarm.GoTo(vehicles=["quad1"], to=[(10.0, 0.0, -140.0)]), unknown)
    said = FleetView({"quad1": replace(seen, home_ned=None, ground=-5.0)})
    with pytest.raises(BadInput, match=r"1\.0 m under the ground"):
        held(lower, said)
    stands = FleetView({"quad1": replace(seen, home_ned=None, airborne=False)})
    with pytest.raises(BadInput, match=r"6\.0 m under the ground"):
        held(lower, stands)


def test_a_vehicle_s_own_fence_counts_for_it_and_the_fleet_s_for_the_others() -> None:
    own = {"quad2": Geofence(radius=3000.0, ceiling=200.0), "quad3": Geofence(radius=50.0)}
    far: list[Vector] = [(10.0, 0.0, -20.0), (2000.0, 0.0, -150.0), (20.0, 0.0, -20.0)]
    held(swarm.GoTo(vehicles=NAMES, to=far), own=own)
    with pytest.raises(BadInput, match=r"goal\.to\[1\]: for quad2"):
        held(swarm.GoTo(vehicles=NAMES, to=far))
    near: list[Vector] = [(10.0, 0.0, -20.0), (20.0, 0.0, -20.0), (60.0, 0.0, -20.0)]
    held(swarm.GoTo(vehicles=NAMES, to=near))
    with pytest.raises(BadInput, match=r"goal\.to\[2\]: for quad3, 10\.0 m beyond the geofence's radius of 50 m"):
        held(swarm.GoTo(vehicles=NAMES, to=near), own=own)
    with pytest.raises(BadInput, match=r"goal\.at\[2\]: for quad3"):
        held(swarm.Land(vehicles=NAMES, at=[(0.0, 0.0), (0.0, 9.0), (0.0, 70.0)]), own=own)


def test_what_is_left_of_a_search_is_held_to_the_fence_too() -> None:
    polygon = [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0)]
    inside, beyond = [(0.0, 0.0, -20.0), (40.0, 0.0, -20.0)], [(0.0, 0.0, -20.0), (5000.0, 0.0, -20.0)]
    held(swarm.Search(vehicles=NAMES[:2], polygon=polygon, height=20.0, lanes=[inside, inside]))
    with pytest.raises(BadInput, match=r"goal\.lanes\[1\]: for quad2"):
        held(swarm.Search(vehicles=NAMES[:2], polygon=polygon, height=20.0, lanes=[inside, beyond]))


def test_a_fence_s_polygon_counts_when_the_goal_is_given() -> None:
    origin = Origin(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0)
    square = Geofence(polygon=[(49.999, 7.998), (50.001, 7.998), (50.001, 8.002), (49.999, 8.002)])  # 111 m, 143 m
    held(swarm.GoTo(vehicles=NAMES[:1], to=[(100.0, 130.0, -20.0)]), declared=square, origin=origin)
    out = swarm.GoTo(vehicles=NAMES[:1], to=[(150.0, 0.0, -20.0)])
    with pytest.raises(BadInput, match="outside the geofence's polygon"):
        held(out, declared=square, origin=origin)
    with pytest.raises(BadInput, match="outside the geofence's polygon"):
        held(out, own={"quad1": square}, origin=origin)
    held(out, declared=square)  # where it lies, nobody knows without an origin


def test_the_planner_takes_the_fences_and_the_origin_from_the_fleet_file() -> None:
    origin = Origin(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0)
    small = Geofence(radius=50.0)
    vehicles = {"quad1": VehicleConfig(link="udp:14550", geofence=small), "quad2": VehicleConfig(link="udp:14551")}
    file = FleetConfig(fleet="f", origin=origin, geofence=Geofence(radius=400.0), vehicles=vehicles)
    field = field_of(file)
    assert field.fence("quad1").radius == 50.0
    assert field.fence("quad2").radius == field.fence("heard_of_later").radius == 400.0
    assert field.fence("quad1").origin == origin
