"""What becomes of a segment that is put: taken, refused, or lost with the network for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
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
        self.says: Callable[[], None] = lambda: None
        """is called where something does not come true"""
        self.number, self.lost = 7, None
        self.last_state: wire.VehicleState | None = None

    def segment(self, points: list[wire.SegmentPoint]) -> None:
        self.sent += 1
        if self.takes:
            flown = wire.swarm.SegmentInfo(lease=self.number, seq=self.sent, start=0.0, rests=1.0, end=1.0)
            self.last_state = wire.VehicleState(t=0.0, fleet="demo", name=self.name, instance="", segment=flown)

    async def wait_until(self, true: Callable[[wire.VehicleState], bool], timeout: float) -> wire.VehicleState:
        if self.last_state is None or not true(self.last_state):
            self.says()
            raise TimedOut("it did not come true")
        return self.last_state


def dropped(why: str | None) -> wire.Event:
    detail = {} if why is None else {"why": why}
    return wire.Event(t=0.0, kind="setpoint", severity="warning", text=f"dropped: {why}", detail=detail)


async def test_a_silent_network_loses_a_segment_and_ends_no_flight() -> None:
    vehicle = Vehicle()
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    assert await by.give(POINTS)
    vehicle.age, vehicle.takes = TAKEN + 0.5, False
    for _ in range(TRIES + 1):
        assert await by.give(POINTS) is None
        assert by.settled() is None
        by.check()
    vehicle.age, vehicle.takes = 0.1, True
    assert by.settled() is False
    assert await by.give(POINTS)
    assert by.settled()


async def test_what_was_taken_in_a_silence_is_known_once_the_vehicle_is_heard_again() -> None:
    vehicle = Vehicle()
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    assert await by.give(POINTS)
    before = vehicle.last_state
    vehicle.age, vehicle.takes = TAKEN + 0.5, False
    assert await by.give(POINTS) is None
    vehicle.takes = True
    vehicle.sent -= 1
    vehicle.segment(POINTS)  # it had it
    after, vehicle.last_state = vehicle.last_state, before
    assert by.settled() is None
    vehicle.age, vehicle.last_state = 0.1, after
    assert by.settled() is True
    by.check()


async def test_what_a_vehicle_that_is_heard_does_not_take_is_refused() -> None:
    vehicle = Vehicle()
    vehicle.takes = False
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    for _ in range(TRIES - 1):
        assert not await by.give(POINTS)
    with pytest.raises(Refused, match="does not fly the segment"):
        await by.give(POINTS)
    assert vehicle.sent == TRIES
    with pytest.raises(Refused, match="does not fly the segment"):
        by.check()


async def test_what_a_network_held_back_until_it_was_too_late_is_put_again() -> None:
    vehicle = Vehicle()
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    vehicle.takes, vehicle.says = False, lambda: by.hear(dropped("late"))
    assert not await by.give(POINTS)
    vehicle.takes = True
    assert await by.give(POINTS)


@pytest.mark.parametrize(
    ("why", "tries"), [("late", TRIES), ("order", TRIES), ("link", TRIES), (None, TRIES), ("invalid", 1)]
)
async def test_the_vehicle_s_reason_is_told_and_one_that_stays_is_not_asked_again(why: str | None, tries: int) -> None:
    """By a clock that is off all that comes is late."""
    vehicle = Vehicle()
    by = ByLease(cast("zmav.Vehicle", vehicle), cast("zmav.Lease", vehicle))
    vehicle.takes, vehicle.says = False, lambda: by.hear(dropped(why))
    for _ in range(tries - 1):
        assert not await by.give(POINTS)
    with pytest.raises(Refused, match=f"dropped: {why}"):
        await by.give(POINTS)
    assert vehicle.sent == tries


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


def test_no_course_has_ended_whose_end_was_lost_and_a_vehicle_has_time_to_take_it() -> None:
    course = Course(Trajectory(shape("square", (0.0, 0.0, -5.0), side=20.0), Limits(1.0, 1.0, 2.0)), 1000.0)
    late = 1000.0 + course.trajectory.duration + 3.0
    assert course.due(late) is not None
    assert course.ended(late)
    course.again()
    assert not course.ended(late)
    points = course.due(late)
    assert points is not None
    assert points[-1].t > late + TAKEN / 2
    assert len({point.pos for point in points}) == 1
    assert course.ended(late)


def test_a_brake_that_was_lost_is_made_again_from_where_the_vehicle_has_come_to_without_it() -> None:
    trajectory = Trajectory(shape("square", (0.0, 0.0, -5.0), side=20.0), Limits(1.0, 1.0, 2.0))
    course = Course(trajectory, 1000.0)
    assert course.due(1000.0) is not None
    course.brake()
    assert course.due(1005.0) is not None
    course.again()
    assert not course.ended(1010.0)
    points = course.due(1010.0)
    assert points is not None
    assert points[0].pos == pytest.approx(trajectory.at(np.array([10.0])).pos[0])
    assert points[-1].vel == (0.0, 0.0, 0.0)
    assert points[-1].t < 1013.0
    assert not course.ended(1010.0)
    assert course.ended(1013.0)


def test_a_brake_before_it_sets_off_that_was_lost_is_due_again() -> None:
    course = Course(Trajectory(shape("square", (0.0, 0.0, -5.0), side=20.0), Limits(1.0, 1.0, 2.0)), 1000.0)
    course.brake()
    assert course.due(999.0) is not None
    course.again()
    assert not course.ended(1001.0)
    assert course.due(1001.0) is not None


def test_a_brake_that_takes_long_is_gone_on_with() -> None:
    course = Course(Trajectory(shape("square", (0.0, 0.0, -5.0), side=1000.0), Limits(10.0, 0.2, 2.0)), 1000.0)
    assert course.due(1060.0) is not None
    course.brake()
    assert course.due(1061.0) is not None
    braked = course.trajectory
    for now in (1072.0, 1084.0):
        assert course.due(now) is not None
        course.again()
        points = course.due(now + 1.0)
        assert points is not None
        assert points[0].pos == pytest.approx(braked.at(np.array([now - 999.0])).pos[0], abs=1e-3)
    assert course.trajectory.duration == pytest.approx(braked.duration, abs=0.1)
