"""Goals as steps: what each kind comes down to, and who is named where one cannot be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import FleetView, Fly, Loiter, Orders, PlanTo, Stop, Track
from agents.planner.model.scene import Bounds, Box, Fence
from tests.agents.planner.goals.team import GATE, fly_all, ground, lasting, team, view
from zmav.errors import BadInput, Refused, Unsupported
from zmav.wire import swarm

FLEET = FleetView(
    {
        "c1": view("c1", (0.0, 0.0, -10.0)),
        "c2": view("c2", (0.0, 6.0, -10.0)),
        "down": view("down", (0.0, 12.0, 0.0), airborne=False),
        "r1": view("r1", (0.0, 18.0, -0.5), "rover", airborne=False),
        "p1": view("p1", (0.0, 90.0, -50.0), "plane"),
    }
)


def square(names: list[str]) -> list[swarm.Goal]:
    return [
        swarm.GoTo(vehicles=names, to=[(30.0, 10.0 * i, -10.0) for i in range(len(names))]),
        swarm.Formation(vehicles=names, shape="line", at=(30.0, 0.0, -10.0)),
        swarm.Search(vehicles=names, polygon=[(0.0, 0.0), (0.0, 50.0), (50.0, 0.0)], height=10.0),
    ]


@pytest.mark.parametrize("kind", range(3))
@pytest.mark.parametrize(
    ("names", "error", "match"),
    [
        ([], BadInput, "no vehicle"),
        (["c1", "nobody"], BadInput, "nobody"),
        (["c1", "c2", "c1"], BadInput, "c1 more than once"),
        (["c1", "down"], Refused, "down is on the ground"),
    ],
)
def test_vehicles_that_cannot_are_named(kind: int, names: list[str], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        resolve(square(names)[kind], FLEET, ground())


def test_a_plane_stands_in_no_formation() -> None:
    with pytest.raises(Unsupported, match="p1 cannot hover"):
        resolve(swarm.Formation(vehicles=["c1", "p1"], shape="line", at=(0.0, 0.0, -10.0)), FLEET, ground())


@pytest.mark.parametrize(
    ("goal", "field"),
    [
        (swarm.GoTo(vehicles=["c1", "c2"], to=[(0.0, 0.0, -10.0), (0.0, 1.0, -10.0)]), "to"),
        (swarm.Formation(vehicles=["c1", "c2"], shape="line", at=(0.0, 0.0, -9.0), spacing=1.9), "spacing"),
        (swarm.Search(vehicles=["c1"], polygon=[(0.0, 0.0), (9.0, 9.0)], height=10.0), "polygon"),
    ],
)
def test_what_is_wrong_with_a_goal_is_named(goal: swarm.Goal, field: str) -> None:
    with pytest.raises(BadInput) as e:
        resolve(goal, FLEET, ground())
    assert e.value.detail["field"] == field


def test_rovers_go_where_they_are_sent_on_their_own_height() -> None:
    (step,) = resolve(swarm.GoTo(vehicles=["r1", "c1"], to=[(9.0, 9.0, -30.0), (0.0, 0.0, -20.0)]), FLEET, ground())
    assert isinstance(step, PlanTo) and step.labelled
    assert step.places == pytest.approx(np.array([[9.0, 9.0, 0.5], [0.0, 0.0, 20.0]]))
    (line,) = resolve(swarm.Formation(vehicles=["c1", "r1"], shape="line", at=(30.0, 0.0, -10.0)), FLEET, ground())
    assert isinstance(line, PlanTo) and line.labelled
    assert list(line.places[:, 2]) == [10.0, 0.5]


def test_planes_circle_where_they_are_sent() -> None:
    goal = swarm.GoTo(vehicles=["p1", "c1"], to=[(90.0, 0.0, -60.0), (0.0, 0.0, -20.0)])
    circles, step = resolve(goal, FLEET, ground())
    assert isinstance(circles, Loiter) and circles.vehicles == ("p1",)
    assert circles.circles[0].centre_ned[:2] == (90.0, 0.0)
    assert isinstance(step, PlanTo) and step.vehicles == ("c1",)
    with pytest.raises(BadInput, match="p1 is a plane"):
        resolve(swarm.GoTo(vehicles=["p1", "c1"], to=[(9.0, 0.0, -60.0)] * 2, labelled=False), FLEET, ground())


def test_planes_circles_are_inside_and_clear() -> None:
    wall = Box(min=(-40.0, 60.0, 0.0), max=(40.0, 70.0, 300.0))
    goal = swarm.GoTo(vehicles=["p1"], to=[(-400.0, 0.0, -60.0)])
    wide = Bounds(min=(-900.0, -900.0, 0.0), max=(900.0, 900.0, 300.0))
    (step,) = resolve(goal, FLEET, ground(bounds=wide))
    assert isinstance(step, Loiter)
    for world in (ground([wall]), ground(bounds=Bounds(min=(-90.0, -90.0, 0.0), max=(90.0, 90.0, 300.0)))):
        with pytest.raises(BadInput, match="p1 has no room to circle") as e:
            resolve(swarm.GoTo(vehicles=["p1"], to=[(90.0, 0.0, -60.0)]), FLEET, world)
        assert e.value.detail["field"] == "to"


def test_unlabelled_rovers_stay_on_the_ground() -> None:
    goal = swarm.GoTo(vehicles=["c1", "r1"], to=[(0.0, 18.0, -10.0), (0.0, 0.0, -10.0)], labelled=False)
    (step,) = resolve(goal, FLEET, ground())
    assert isinstance(step, PlanTo) and step.labelled
    assert step.places == pytest.approx(np.array([[0.0, 0.0, 10.0], [18.0, 0.0, 0.5]]))


def test_takeoff_landing_and_return_are_orders() -> None:
    (up,) = resolve(swarm.TakeOff(vehicles=["down"], height=8.0), FLEET, ground())
    assert isinstance(up, Orders) and "takeoff" in [order.verb for order in up.orders]
    for goal in (swarm.Land(vehicles=["c1", "c2"]), swarm.Return(vehicles=["c1", "c2"])):
        to, down = resolve(goal, FLEET, ground())
        assert isinstance(to, PlanTo) and isinstance(down, Orders)
        assert [order.verb for order in down.orders] == ["land", "land"]


def test_nobody_lands_on_a_roof_or_outside_the_fence() -> None:
    roof = Box(min=(-3.0, -3.0, 0.0), max=(3.0, 3.0, 8.0))
    fence = Fence(polygon=[(-20.0, -20.0), (40.0, -20.0), (40.0, 40.0), (-20.0, 40.0)], floor=2.0, ceiling=40.0)
    to, _ = resolve(swarm.Land(vehicles=["c1"]), FLEET, ground([roof], fence))
    assert isinstance(to, PlanTo)
    assert 4.0 <= np.abs(to.places[0, :2]).max() < 8.0, "beside the box below it, and no farther than it must"


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"leader": "c1"}, "leader"),
        ({"leader": "c2", "offsets": [(0.0, 0.0, 0.0)]}, "offsets"),
    ],
)
def test_who_cannot_be_followed_is_named(more: dict[str, Any], field: str) -> None:
    with pytest.raises(BadInput) as e:
        resolve(swarm.Follow(vehicles=["c1"], **more), FLEET, ground())
    assert e.value.detail["field"] == field


def test_following_is_tracked() -> None:
    (step,) = resolve(swarm.Follow(vehicles=["c1"], leader="r1"), FLEET, ground())
    assert isinstance(step, Track) and step.vehicles == ("c1",)


def test_hold_stops() -> None:
    assert resolve(swarm.Hold(vehicles=["c1", "p1"]), FLEET, ground()) == [Stop(("c1", "p1"), "holding")]


@pytest.mark.parametrize("shape", ["vee", "circle"])
def test_a_formation_forms_up_and_flies_around_what_is_in_its_way(shape: Any) -> None:
    fleet, world = team(9), ground([Box(min=(-3.0, 20.0, 0.0), max=(3.0, 30.0, 60.0))])
    names = list(fleet.vehicles)
    goal = swarm.Formation(
        vehicles=names, shape=shape, at=(20.0, 70.0, -20.0), via=[(30.0, -70.0, -20.0)], heading=1.57
    )
    up, fly = resolve(goal, fleet, world)
    assert isinstance(up, PlanTo) and isinstance(fly, Fly)
    (fallback,) = fly.instead
    ends = np.array([fly.motions[name][-1, 1:] for name in fallback.vehicles])
    assert ends == pytest.approx(fallback.places, abs=1e-3), "the same places when it has to go by a plan"
    assert fly_all([up, fly], fleet, world) > lasting(fly)
    assert fly_all([up, fallback], fleet, world) > 0.0


def test_a_shape_that_does_not_get_through_goes_by_plans() -> None:
    fleet, world = team(9), ground(GATE)
    goal = swarm.Formation(
        vehicles=list(fleet.vehicles), shape="line", at=(0.0, 6.0, -10.0), via=[(0.0, -60.0, -10.0)], heading=1.57
    )
    steps = resolve(goal, fleet, world)
    assert [type(step) for step in steps] == [PlanTo, PlanTo]
    assert fly_all(steps, fleet, world) > 0.0
