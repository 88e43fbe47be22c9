"""What becomes of a segment that is put: taken, refused, or lost with the network for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest

import zmav
from agents.navigator.agent import OVERLAP, Course
from agents.navigator.outlets import TAKEN, TRIES, ByLease
from agents.navigator.routes import shape
from agents.navigator.trajectory import WINDOW, Limits, Trajectory
from zmav import wire
from zmav.errors import Refused, TimedOut

POINTS = [wire.SegmentPoint(t=float(t), pos=(0.0, 0.0, -5.0)) for t in (0, 1)]


class Vehicle:
    """Takes what it hears; ``age``: s since it was heard itself."""

    name = "quad1"

    def __init__(self) -> None:
        self.age, self.takes, self.sent = 0.1, True, 0
        self.number, self.lost = 7, None
        self.last_state: wire.VehicleState | None = None

    def segment(self, points: list[wire.SegmentPoint]) -> None:
        self.sent += 1
        if self.takes:
            flown = wire.swarm.SegmentInfo(lease=self.number, seq=self.sent, start=0.0, rests=1.0, end=1.0)
            self.last_state = wire.VehicleState(t=0.0, fleet="demo", name=self.name, instance="", segment=flown)

    async def wait_until(self, true: Callable[[wire.VehicleState], bool], timeout: float) -> wire.VehicleState:
        if self.last_state is None or not true(self.last_state):
            raise TimedOut("it did not come true")
        return self.last_state


async def test_a_silent_network_loses_a_segment_and_ends_no_flight() -> None:
    vehicle = Vehicle()
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    assert await by.give(POINTS)
    vehicle.age, vehicle.takes = TAKEN + 0.5, False
    for _ in range(TRIES + 1):
        assert not await by.give(POINTS)
        by.check()
    vehicle.age, vehicle.takes = 0.1, True
    assert await by.give(POINTS)


async def test_what_a_vehicle_that_is_heard_does_not_take_is_refused() -> None:
    vehicle = Vehicle()
    vehicle.takes = False
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    with pytest.raises(Refused, match="does not fly the segment"):
        await by.give(POINTS)
    assert vehicle.sent == TRIES
    with pytest.raises(Refused, match="does not fly the segment"):
        by.check()


def test_what_was_lost_is_due_again_as_it_is_by_then() -> None:
    course = Course(Trajectory(shape("square", (0.0, 0.0, -5.0), side=20.0), Limits(1.0, 1.0, 2.0)), 1000.0)
    assert course.due(1000.0) is not None
    late = 1000.0 + WINDOW - OVERLAP + 1.0
    assert course.due(late) is not None
    assert course.due(late + 1.0) is None
    course.again()
    points = course.due(late + 1.0)
    assert points is not None
    assert points[0].t == pytest.approx(late + 1.0)
