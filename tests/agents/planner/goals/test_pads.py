"""Up from and down onto crowded pads: anyone who goes when the orders allow it meets nobody."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from agents.planner.goals import pads
from agents.planner.goals.steps import Loiter, Orders, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.live.scenes import Room, scene_of
from agents.planner.live.world import World
from agents.planner.model.validate import validate
from zmav.config import BodyConfig, body_of
from zmav.errors import BadInput, Refused, Unsupported
from zmav.wire import Vector
from zmav.wire.swarm import Corner

DOWNWASH = 1.5


def view(name: str, pos: Vector, kind: str = "copter", *, up: bool = False, home: Vector | None = None) -> VehicleView:
    where = home or (pos[0], pos[1], 0.0)
    return VehicleView(name, kind, body_of(kind), pos, airborne=up, home_ned=where)


def pad(rows: int, spacing: float) -> list[VehicleView]:
    return [view(f"v{i}{j}", (i * spacing, j * spacing, 0.0)) for i in range(rows) for j in range(rows)]


def anywhere(place: Vector, radius: float) -> bool:
    return True


def takeoff(views: Sequence[VehicleView], height: float) -> list[Step]:
    return pads.takeoff(views, height, DOWNWASH, anywhere)


def land(views: Sequence[VehicleView], at: Sequence[Corner] = (), free: pads.Free = anywhere) -> list[Step]:
    return pads.land(views, at, DOWNWASH, free, lambda spot: pads.APPROACH)


def home(views: Sequence[VehicleView]) -> list[Step]:
    return pads.home(views, DOWNWASH, lambda spot: pads.APPROACH)


def apart(a: Vector, b: Vector) -> float:
    return math.hypot(math.dist(a[:2], b[:2]), (a[2] - b[2]) / DOWNWASH)


def runs(orders: Orders, columns: dict[str, tuple[Vector, Vector]], seed: int) -> None:
    """Carry the orders out in some sequence that ``after`` allows: each goes from the first to the second of its
    places, and is never within the sum of the radii of anybody who is off the ground.
    """
    rng = np.random.default_rng(seed)
    at = {name: column[0] for name, column in columns.items()}
    done: set[int] = set()
    while len(done) < len(orders.orders):
        able = [k for k, o in enumerate(orders.orders) if k not in done and done.issuperset(o.after)]
        assert able, "somebody waits for himself"
        going = [k for k in able if rng.random() < 0.7] or able[:1]
        for share in np.linspace(0.0, 1.0, 41):
            for k in going:
                name = orders.orders[k].vehicle
                begin, end = columns[name]
                at[name] = (begin[0], begin[1], begin[2] + float(share) * (end[2] - begin[2]))
            for one, other in itertools.combinations(at, 2):
                if max(-at[one][2], -at[other][2]) > 3.0:  # lower they are as near as the pads are
                    assert apart(at[one], at[other]) >= 2.0 - 1e-9, (one, other, at[one], at[other])
        done.update(going)


def test_a_roomy_pad_takes_off_at_once() -> None:
    (step,) = takeoff(pad(3, 5.0), 10.0)
    assert isinstance(step, Orders)
    assert {(order.verb, order.args["alt_rel"], order.after) for order in step.orders} == {("takeoff", 10.0, ())}


@pytest.mark.parametrize("spacing", [1.0, 1.6, 2.2])
def test_a_crowded_pad_takes_off_the_highest_first(spacing: float) -> None:
    views = pad(3, spacing)
    step, spread = takeoff(views, 10.0)
    assert isinstance(step, Orders) and isinstance(spread, PlanTo)
    tops = {o.vehicle: o.args["alt_rel"] for o in step.orders}
    assert min(tops.values()) == 10.0
    columns = {v.name: (v.pos_ned, (v.pos_ned[0], v.pos_ned[1], -tops[v.name])) for v in views}
    for seed in range(5):
        runs(step, columns, seed)
    assert spread.vehicles == tuple(v.name for v in views) and not spread.labelled
    assert np.all(spread.places[:, 2] == 10.0)
    for a, b in itertools.combinations(spread.places, 2):
        assert np.linalg.norm(a - b) >= 2.0


def test_pads_at_different_heights_count_from_each_ones_home() -> None:
    views = [view("low", (0.0, 0.0, 0.0)), view("roof", (1.5, 0.0, -4.0))]
    step = takeoff(views, 6.0)[0]
    assert isinstance(step, Orders)
    assert [(o.vehicle, o.args["alt_rel"]) for o in step.orders] == [("roof", 6.0), ("low", 6.0)]
    assert step.orders[1].after == (0,)


def test_who_cannot_take_off_is_named() -> None:
    with pytest.raises(Unsupported, match="r1"):
        takeoff([view("r1", (0.0, 0.0, 0.0), "rover")], 5.0)
    with pytest.raises(Refused, match="a fly already"):
        takeoff([view("a", (0.0, 0.0, -3.0), up=True)], 5.0)


def landing(steps: Sequence[object]) -> tuple[PlanTo, Orders]:
    plan, orders = steps
    assert isinstance(plan, PlanTo) and isinstance(orders, Orders)
    return plan, orders


@pytest.mark.parametrize("spacing", [1.0, 2.2, 6.0])
def test_home_onto_a_crowded_pad_the_lowest_first(spacing: float) -> None:
    views = [view(v.name, (50.0 + 5.0 * k, 0.0, -20.0), up=True, home=v.pos_ned) for k, v in enumerate(pad(3, spacing))]
    plan, orders = landing(home(views))
    assert plan.labelled
    tops = dict(zip(plan.vehicles, map(tuple, frames.enu_array(plan.places)), strict=True))
    for one, other in itertools.combinations(tops.values(), 2):
        assert apart(one, other) >= 2.0
    homes = {v.name: v.home_ned or v.pos_ned for v in views}
    assert all(math.dist(tops[name][:2], homes[name][:2]) < 1e-9 for name in homes)
    for seed in range(4):
        runs(orders, {name: (tops[name], homes[name]) for name in homes}, seed)
    assert all(not order.after for order in orders.orders) == (spacing > 5.0)


def test_landing_below_finds_room_for_those_above_each_other_and_keeps_off_what_is_not_free() -> None:
    views = [view("top", (0.0, 0.0, -20.0), up=True), view("under", (0.3, 0.0, -10.0), up=True)]

    def free(place: Vector, radius: float) -> bool:
        return place[0] > -0.1

    plan, orders = landing(land(views, free=free))
    (n0, e0, _), (n1, e1, _) = frames.enu_array(plan.places)
    assert math.dist((n0, e0), (n1, e1)) >= 2.0 and min(n0, n1) > -0.1
    assert [order.after for order in orders.orders] == [(), ()]
    with pytest.raises(BadInput, match="no free place"):
        land(views, free=lambda place, radius: False)


def test_who_stands_on_the_ground_has_landed() -> None:
    parked, armed = view("parked", (0.0, 0.0, 0.0)), dataclasses.replace(view("armed", (9.0, 0.0, 0.0)), armed=True)
    assert land([parked]) == []
    (stopping,) = land([parked, armed])
    assert isinstance(stopping, Orders)
    assert [(order.vehicle, order.verb) for order in stopping.orders] == [("armed", "land")]
    plan, orders = landing(land([parked, view("flies", (20.0, 0.0, -9.0), up=True)]))
    assert plan.vehicles == ("flies",)
    assert [order.vehicle for order in orders.orders] == ["flies"]
    with pytest.raises(Refused, match="parked: on the ground"):
        land([parked], [(3.0, 3.0)])


def test_given_spots_go_to_whoever_is_near() -> None:
    views = [view("a", (0.0, 0.0, -9.0), up=True), view("b", (30.0, 0.0, -9.0), up=True)]
    plan, _ = landing(land(views, [(28.0, 1.0), (2.0, 1.0)]))
    assert frames.enu_array(plan.places)[:, 0].tolist() == [2.0, 28.0]
    for at, words in (([(0.0, 0.0)], "1 places"), ([(0.0, 0.0), (1.0, 0.0)], "1.0 m apart")):
        with pytest.raises(BadInput, match=words) as raised:
            land(views, at)
        assert raised.value.detail["field"] == "at"
    hill = [*views, view("h", (60.0, 0.0, -40.0), up=True, home=(60.0, 0.0, -20.0))]
    plan, _ = landing(land(hill, [(28.0, 1.0), (2.0, 1.0), (59.0, 0.0)]))
    assert plan.places[:, 2].min() > 20.0, "nobody waits below the highest ground that is known"
    with pytest.raises(Unsupported, match="p"):
        land([view("p", (0.0, 0.0, -60.0), "plane", up=True)])


def test_a_mixed_fleet_comes_home() -> None:
    views = [
        view("c", (50.0, 0.0, -20.0), up=True, home=(0.0, 0.0, 0.0)),
        view("r", (60.0, 5.0, 0.0), "rover", home=(10.0, 5.0, 0.0)),
        view("p", (80.0, 5.0, -70.0), "plane", up=True, home=(20.0, 5.0, 0.0)),
        view("q", (90.0, 5.0, -75.0), "plane", up=True, home=(25.0, 5.0, 0.0)),
    ]
    circles, plan, orders = home(views)
    assert isinstance(circles, Loiter) and isinstance(plan, PlanTo) and isinstance(orders, Orders)
    first, second = (-circle.centre_ned[2] for circle in circles.circles)
    assert circles.vehicles == ("p", "q") and first == 70.0 and second - first >= DOWNWASH * 8.0
    assert plan.vehicles == ("c", "r") and orders.vehicles == ("c",)
    with pytest.raises(Refused, match="home of x"):
        home([VehicleView("x", "copter", body_of("copter"), (0.0, 0.0, -5.0), airborne=True)])


def test_what_positions_may_be_off_across_makes_nobody_climb_higher_than_above_another() -> None:
    two = [view("a", (0.0, 0.0, 0.0)), view("b", (0.0, 4.0, 0.0))]
    unsure = [dataclasses.replace(each, body=body_of("copter", BodyConfig(radius=3.5)), room=2.5) for each in two]
    lifts = pads.stacked(unsure, [(0.0, 0.0, -10.0), (0.0, 4.0, -10.0)], DOWNWASH)
    bare = pads.keep_of(*two)
    assert sorted(lifts) == [0.0, pytest.approx(DOWNWASH * bare)]
    assert pads.stacked(unsure, [(0.0, 0.0, -10.0), (0.0, 8.5, -10.0)], DOWNWASH) == [0.0, 0.0]


@pytest.mark.parametrize("flat", [0.5, 4.0, 7.0])
def test_a_plan_can_be_made_to_where_those_wait_who_land_beside_each_other(flat: float) -> None:
    """With receivers of one frequency, whose positions need more room than there is between pads."""
    unsure = [
        dataclasses.replace(
            view(f"v{k}", (40.0, 20.0 * k, -15.0), up=True, home=(0.0, flat * k, 0.0)),
            body=body_of("copter", BodyConfig(radius=4.1)),
            room=2.6,
        )
        for k in range(3)
    ]
    plan, _ = home(unsure)
    assert isinstance(plan, PlanTo)
    scene = scene_of(unsure, plan.places, True, Room((), (), World().pieces(0.0), DOWNWASH, None))
    validate(scene)
