"""What batteries say, what is learnt from it, what a goal takes by that, and who may not fly it."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from agents.planner.goals.steps import FleetView, Fly, Orders, PlanTo, VehicleOrder, VehicleView
from agents.planner.live.energy import WITHIN, Consumption, Energy, Need, check, warning_of
from agents.planner.live.tally import AROUND_S, SPOOL_S, Tally, landing
from zmav.config import body_of
from zmav.errors import Refused
from zmav.wire import swarm

COPTER = body_of("copter")


def flown(second: float, metre: float, seconds: float, pace: float = 5.0, left: float = 1.0) -> Consumption:
    """A flight of hovers and of straight ways by turns, half a minute each, by a battery that tells hundredths."""
    known, at, t = Consumption(), 0.0, 0.0
    while t < seconds and left > 0.0:
        speed = pace if int(t / 30.0) % 2 else 0.0
        at, left, t = at + 0.2 * speed, left - 0.2 * (second + metre * speed), t + 0.2
        known.heard(t, round(left, 2), np.array([at, 0.0, 10.0]), True)
    return known


@pytest.mark.parametrize(("second", "metre"), [(1.0 / 600.0, 0.0), (1.0 / 900.0, 1.0 / 9000.0), (1.0 / 1500.0, 2e-4)])
def test_shares_a_second_and_a_metre_are_learnt_from_the_battery_s_own_figures(second: float, metre: float) -> None:
    a, b = flown(second, metre, 500.0).rates(900.0)
    assert 300.0 * a == pytest.approx(300.0 * second, rel=0.2), "a hover of five minutes"
    assert 100.0 * a + 500.0 * b == pytest.approx(100.0 * second + 500.0 * metre, rel=0.1), "a way of 500 m"


def test_without_a_flight_it_is_what_the_endurance_says() -> None:
    assert Consumption().rates(900.0) == pytest.approx((1.0 / 900.0, 0.0))


def test_a_battery_that_says_nonsense_teaches_within_bounds() -> None:
    known = Consumption()
    for k in range(2000):
        known.heard(0.2 * k, (k * 37 % 100) / 100.0, np.array([math.sin(k), 0.0, 0.0]), True)
    second, metre = known.rates(900.0)
    assert WITHIN[0] / 900.0 <= second <= WITHIN[1] / 900.0
    assert metre >= 0.0


def test_what_goes_on_the_ground_teaches_nothing_nor_does_a_new_pack() -> None:
    known = Consumption()
    for k in range(200):
        known.heard(10.0 * k, 1.0 - 0.01 * (k % 90), np.zeros(3), False)
    known.heard(3000.0, 0.1, np.zeros(3), True)
    known.heard(3001.0, 0.9, np.zeros(3), True)
    assert known.rates(900.0) == pytest.approx((1.0 / 900.0, 0.0))


def test_a_cell_that_dies_is_no_consumption() -> None:
    known = flown(1.0 / 600.0, 0.0, 300.0)
    before = known.rates(900.0)
    known.heard(301.0, 0.2, np.zeros(3), True)
    for k in range(3):
        known.heard(302.0 + k, 0.2, np.zeros(3), True)
    assert known.rates(900.0) == before


# What a goal takes.


def view(name: str, north: float, height: float, **body: float) -> VehicleView:
    own = msgspec.structs.replace(COPTER, **body)
    return VehicleView(name, "copter", own, (north, 0.0, -height), airborne=height > 0.0, home_ned=(0.0, 0.0, 0.0))


def fleet(*views: VehicleView) -> FleetView:
    return FleetView({each.name: each for each in views})


def test_a_takeoff_a_way_and_the_way_home_are_counted() -> None:
    seen = fleet(view("a", 0.0, 0.0))
    tally = Tally(["a"], seen)
    up = Orders((VehicleOrder("a", "takeoff", {"alt_rel": 10.0}),))
    assert tally.add(up) == pytest.approx(SPOOL_S + 10.0 / COPTER.climb)
    motion = np.array([[0.0, 0.0, 0.0, 10.0], [25.0, 0.0, 100.0, 10.0]])
    assert tally.add(PlanTo(("a",), motion[-1:, 1:]), {"a": motion}) == pytest.approx(25.0 + AROUND_S)
    part = tally.parts["a"]
    assert (part.metres, part.seconds) == pytest.approx((110.0, tally.seconds))
    seconds, metres = tally.home("a")
    assert metres == pytest.approx(110.0)
    assert seconds == pytest.approx(100.0 / 5.0 + 5.0 / seen.vehicles["a"].accel + landing(10.0, seen.vehicles["a"]))


def test_who_waits_in_the_air_for_the_others_uses_his_battery_and_who_is_down_does_not() -> None:
    seen = fleet(view("a", 0.0, 10.0), view("b", 30.0, 10.0))
    tally = Tally(["a", "b"], seen)
    tally.add(Orders((VehicleOrder("a", "land"), VehicleOrder("b", "land", {}, (0,)))))
    down = landing(10.0, seen.vehicles["a"])
    assert tally.parts["a"].seconds == pytest.approx(down)
    assert tally.parts["b"].seconds == pytest.approx(2.0 * down)
    assert tally.home("a") == tally.home("b") == (0.0, 0.0)


def test_lanes_are_counted_as_they_are_flown() -> None:
    motion = np.array([[0.0, 0.0, 0.0, 10.0], [10.0, 40.0, 0.0, 10.0], [20.0, 0.0, 0.0, 10.0]])
    tally = Tally(["a"], fleet(view("a", 0.0, 10.0)))
    tally.add(Fly({"a": motion}))
    assert (tally.parts["a"].metres, tally.parts["a"].seconds) == (80.0, 20.0 + AROUND_S)


# Who may.


def needs(left: float | None, metres: float = 1000.0, reserve: float = 0.2) -> dict[str, Need]:
    seen = fleet(view("a", 0.0, 10.0, reserve=reserve))
    tally = Tally(["a"], seen)
    tally.add(PlanTo(("a",), np.array([[metres, 0.0, 10.0]])))
    return Energy().needs(tally, seen, {"a": left})


GOAL = swarm.GoTo(vehicles=["a"], to=[(0.0, 1000.0, -10.0)])


def test_who_could_not_come_back_with_the_reserve_is_refused_with_the_figures() -> None:
    told = needs(0.6)["a"]
    assert told.left is not None and 0.0 < told.left < 0.2, told
    with pytest.raises(
        Refused, match=r"a could not come back with its reserve of 20 %: .* of the 60 % that it has; lands"
    ):
        check(GOAL, {"a": told}, unknown_allowed=False)
    check(GOAL, needs(0.9), unknown_allowed=False)
    check(GOAL, needs(0.6, reserve=0.0), unknown_allowed=False)


def test_a_battery_that_is_not_known_is_refused_unless_it_is_allowed() -> None:
    with pytest.raises(Refused, match=r"the battery of a is not known \(zmav swarm planner --unknown-batteries"):
        check(GOAL, needs(None), unknown_allowed=False)
    check(GOAL, needs(None), unknown_allowed=True)
    assert "not known" in needs(None)["a"].words()


@pytest.mark.parametrize("goal", [swarm.Land(vehicles=["a"]), swarm.Return(vehicles=["a"]), swarm.Hold(vehicles=["a"])])
def test_what_brings_home_or_stops_is_never_refused(goal: swarm.Goal) -> None:
    for left in (0.01, None):
        check(goal, needs(left), unknown_allowed=False)
        assert warning_of(goal, needs(left), False) == ""


def test_an_empty_battery_is_refused_the_shortest_way() -> None:
    with pytest.raises(Refused):
        check(GOAL, needs(0.1, 1.0), unknown_allowed=True)


def test_the_landing_of_somebody_who_is_lost_is_nobody_s_time() -> None:
    seen = fleet(view("a", 0.0, 10.0))
    tally = Tally(["a"], seen)
    tally.add(Orders((VehicleOrder("gone", "land"), VehicleOrder("a", "land", {}, (0,)))))
    assert tally.seconds == pytest.approx(landing(10.0, seen.vehicles["a"]))
