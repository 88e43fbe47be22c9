"""Planes on their way to circles: nobody leaves its height before those in its way have left theirs."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any, cast

import msgspec
import numpy as np

import zmav
from agents.planner.goals import pads
from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import FleetView, Fly, Loiter, PlanTo, Step, VehicleView
from agents.planner.live.frames import enu
from agents.planner.live.orders import circle
from agents.planner.live.plan import circles, points_of
from agents.planner.live.scenes import Room
from agents.planner.live.world import Pieces
from agents.planner.solve.loiter import STEADY
from tests.agents.planner.goals.team import team, view
from zmav import wire
from zmav.config import body_of
from zmav.wire import Vector

BODY = body_of("plane")


class Glider:
    """What a plane does of ``goto`` with a radius: the order is done as soon as it circles there, at whatever height.

    It gets on by one step each time somebody looks at it.
    """

    def __init__(self, name: str, place: Vector, sky: list[Glider], steps: int) -> None:
        self.name, self.place, self.down, self._sky, self._steps = name, place, place[2], sky, steps
        self.orders: list[wire.GoTo] = []
        sky.append(self)

    @property
    def state(self) -> wire.VehicleState:
        local = (self.place[0], self.place[1], self.down)
        return cast(wire.VehicleState, msgspec.defstruct("State", ["local"])(local))

    async def order(self, verb: str, args: wire.GoTo) -> dict[str, Any]:
        assert verb == "goto" and args.pos is not None
        self.orders.append(args)
        self.place = args.pos
        await asyncio.sleep(0)
        return {}

    async def wait_until(self, true: Callable[[Any], bool], timeout: float) -> None:
        for step in range(self._steps):
            await asyncio.sleep(0)
            self.down += (self.place[2] - self.down) / (self._steps - step)
            for one, other in itertools.combinations(self._sky, 2):
                assert abs(one.down - other.down) >= 1.5 * 2.0 * BODY.radius, "two passed each other"
        assert true(self.state) and timeout > 60.0


async def test_planes_change_their_heights_one_after_another() -> None:
    """All of them at one place and all higher: the lowest must wait for all, and climbs fastest."""
    heights = [60.0, 90.0, 120.0, 150.0]
    views = [
        VehicleView(f"p{k}", "plane", BODY, (0.0, 0.0, -height), airborne=True, home_ned=(0.0, 0.0, 0.0))
        for k, height in enumerate(heights)
    ]
    step = pads.circles(views, [(200.0, 0.0, -100.0)] * 4, 1.5)
    sky: list[Glider] = []
    planes = {view.name: Glider(view.name, view.pos_ned, sky, 4 + 9 * k) for k, view in enumerate(views)}
    await circle(cast(dict[str, zmav.Vehicle], planes), step)
    for slot in step.circles:
        *_, last = planes[slot.vehicle].orders
        assert last.pos == slot.centre_ned and last.pos[:2] == (200.0, 0.0) and last.radius == slot.radius
        assert abs(planes[slot.vehicle].down - slot.centre_ned[2]) <= STEADY
    assert np.ptp(_heights(step)) >= 3 * 1.5 * 2.0 * BODY.radius


def _heights(step: Loiter) -> list[float]:
    return sorted(-slot.centre_ned[2] for slot in step.circles)


def resolved(goal: wire.swarm.Goal, fleet: FleetView) -> list[Step]:
    """In a world of which nothing is known, whose bounds are those that the agent makes for the goal."""
    places = [enu(fleet.vehicles[name].pos_ned) for name in goal.vehicles]
    places += [enu(point) for point in points_of(goal, fleet)]
    places += circles(goal, fleet, places)
    return resolve(goal, fleet, Room((), (), Pieces(), 1.5, None).empty(places))


def test_bounds_hold_planes_circles_and_all_of_a_shape() -> None:
    planes = FleetView({f"p{k}": view(f"p{k}", (0.0, 90.0 * k, -60.0 - 30.0 * k), "plane") for k in range(4)})
    names = list(planes.vehicles)
    goals: list[wire.swarm.Goal] = [
        wire.swarm.GoTo(vehicles=names, to=[(300.0, 0.0, -60.0)] * 4),
        wire.swarm.Return(vehicles=names),
    ]
    for goal in goals:
        (step,) = resolved(goal, planes)
        assert isinstance(step, Loiter) and np.diff(_heights(step)).min() >= 1.5 * 2.0 * BODY.radius
    copters = team(12, (0.0, 0.0, -30.0))
    for shape, points in (
        ("circle", []),
        ("custom", [(200.0 * (k == 3), 4.0 * k, 30.0 * (k == 5)) for k in range(12)]),
    ):
        ball = wire.swarm.Formation(
            vehicles=list(copters.vehicles),
            shape=cast(wire.swarm.Shape, shape),
            points=points,
            spacing=6.0,
            at=(100.0, 0.0, -40.0),
            via=[(30.0, 0.0, -40.0)],
        )
        assert [type(step) for step in resolved(ball, copters)] == [PlanTo, Fly], "there is room to fly it in shape"
