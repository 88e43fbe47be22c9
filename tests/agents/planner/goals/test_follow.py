"""Following: places beside what moves, without lag, within limits, and what is done when the leader is lost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.goals import follow
from agents.planner.goals.follow import Heading, MovingTarget
from zmav.config import body_of
from zmav.errors import BadInput
from zmav.wire.swarm import Follow

BODY = body_of("copter")
GOAL = Follow(vehicles=["a", "b", "c"], leader="lead", frame="body")
OFFSETS = [(-6.0, -3.0, 0.0), (-6.0, 3.0, 0.0), (-12.0, 0.0, -2.0)]


def test_body_offsets_turn_with_the_leader_and_feed_its_turning_forward() -> None:
    east = MovingTarget(10.0, (100.0, 50.0, -20.0), (0.0, 3.0, 0.0))
    place = follow.slot(east, Heading(10.0, math.pi / 2.0), (-6.0, 2.0, 1.0), "body", 12.0)
    assert place.pos == pytest.approx((98.0, 50.0, -19.0)) and place.vel == pytest.approx((0.0, 3.0, 0.0))
    turning = Heading(10.0, 0.3, rate=0.2)
    soon, now = (follow.slot(east, turning, (-6.0, 2.0, 1.0), "body", t) for t in (10.001, 10.0))
    moved = (np.array(soon.pos) - np.array(now.pos)) / 0.001
    assert moved == pytest.approx(np.array(now.vel), abs=0.01)
    fixed = follow.slot(east, turning, (-6.0, 2.0, 1.0), "ned", 10.0)
    assert fixed.pos == pytest.approx((94.0, 52.0, -19.0)) and fixed.vel == east.vel


def test_a_leader_that_stands_keeps_its_course() -> None:
    heading = follow.heading_of(None, MovingTarget(0.0, (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), None, 1.0)
    assert heading.course == pytest.approx(math.pi / 2.0)
    for k, vel in enumerate([(0.0, 0.5, 0.0), (-0.3, 0.1, 0.0), (-0.6, 0.0, 0.0), (0.0, 0.0, 0.0)], 1):
        heading = follow.heading_of(heading, MovingTarget(float(k), (0.0, 0.0, 0.0), vel), None, 1.0)
        assert heading.course == pytest.approx(math.pi / 2.0), "slow ones drift anywhere"
    heading = follow.heading_of(heading, MovingTarget(5.0, (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)), None, 9.0)
    assert abs(heading.course) == pytest.approx(math.pi)
    assert follow.heading_of(None, MovingTarget(0.0, (0.0, 0.0, 0.0)), 0.7, 1.0).course == 0.7


def test_the_frame_turns_only_as_fast_as_the_outermost_can() -> None:
    most = follow.most_turn(OFFSETS, [BODY] * 3, speed=2.0)
    arm = math.hypot(12.0, 0.0)
    assert 2.0 + most * arm <= BODY.speed and most * most * arm <= BODY.accel
    heading = follow.heading_of(
        Heading(0.0, 0.0, 0.0, True), MovingTarget(0.5, (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), None, most
    )
    assert heading.course == pytest.approx(0.5 * most) and heading.rate == pytest.approx(most)


def test_places_too_near_each_other_are_refused() -> None:
    assert follow.offsets_of(GOAL, [BODY] * 3, 1.0, 1.5) == follow.default_offsets([BODY] * 3, 1.0)
    for offsets, words in (
        ([(-6.0, 0.0, 0.0), (-6.0, 1.5, 0.0), (-12.0, 0.0, 0.0)], "a and b are 1.5 m apart"),
        ([(-6.0, 0.0, 0.0), (-6.0, 4.0, 0.0), (0.0, 0.0, -2.5)], "the leader and c"),
        ([(-6.0, 0.0, 0.0)], "1 offsets for 3"),
    ):
        bad = Follow(vehicles=GOAL.vehicles, leader="lead", offsets=offsets)
        with pytest.raises(BadInput, match=words) as raised:
            follow.offsets_of(bad, [BODY] * 3, 1.0, 1.5)
        assert raised.value.detail["field"] == "offsets"


@pytest.mark.parametrize(
    "on_lost",
    ["hold", "return", "land"],
)
def test_a_lost_leader(on_lost: str) -> None:
    goal = Follow(vehicles=["a"], leader="lead", on_lost=on_lost, lost_after=3.0)  # type: ignore[arg-type]
    assert [follow.doing(goal, age) for age in (2.9, 3.1, 6.1)] == ["follow", on_lost, on_lost]


def test_segments_reach_a_moving_place_stay_in_limits_and_end_at_rest() -> None:
    place = MovingTarget(0.0, (20.0, 5.0, -12.0), (2.0, 1.0, 0.0))
    now = MovingTarget(0.0, (0.0, 0.0, -10.0), (0.0, 2.0, 0.0))
    worst = []
    for _ in range(20):
        motion = follow.segment(now, place, BODY)
        vel = np.diff(motion[:, 1:], axis=0) / follow.STEP
        acc = np.diff(np.concatenate(([now.vel], vel, [[0.0] * 3])), axis=0) / follow.STEP
        assert np.linalg.norm(vel, axis=1).max() <= BODY.speed
        assert np.linalg.norm(acc[1:-1], axis=1).max() <= BODY.accel + 1e-6
        assert -vel[:, 2].min() <= BODY.climb + 1e-9 and vel[:, 2].max() <= BODY.descend + 1e-9
        assert np.linalg.norm(vel[-1]) <= BODY.accel * follow.STEP
        k = 10  # a second later it is replaced by the next
        now = MovingTarget(float(motion[k, 0]), tuple(motion[k, 1:]), tuple((vel[k - 1] + vel[k]) / 2.0))
        worst.append(math.dist(now.pos, place.at(now.t).pos))
    assert worst[0] > 10.0 and max(worst[12:]) < 0.15, "no lag behind a steady leader"


def test_rovers_keep_their_height() -> None:
    motion = follow.segment(
        MovingTarget(0.0, (0.0, 0.0, -1.0)), MovingTarget(0.0, (5.0, 0.0, -9.0)), body_of("rover"), level=True
    )
    assert np.all(motion[:, 3] == -1.0) and motion[-1, 1] > 1.0
