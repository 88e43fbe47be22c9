"""Following: places beside what moves, without lag, within limits, and what is done when the leader is lost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.goals import follow
from agents.planner.goals.follow import MovingTarget
from zmav.config import body_of
from zmav.errors import BadInput
from zmav.wire.swarm import Follow

BODY = body_of("copter")
GOAL = Follow(vehicles=["a", "b", "c"], leader="lead")


def test_a_place_goes_as_fast_as_its_leader() -> None:
    east = MovingTarget(10.0, (100.0, 50.0, -20.0), (0.0, 3.0, 0.0))
    place = follow.slot(east, (-6.0, 2.0, 1.0), 12.0)
    assert place.pos == pytest.approx((94.0, 58.0, -19.0)) and place.vel == east.vel


def test_places_too_near_each_other_are_refused() -> None:
    assert follow.offsets_of(GOAL, [BODY] * 3, 1.0, 1.5) == follow.default_offsets([BODY] * 3, 1.0)
    for offsets, words in (
        ([(-6.0, 0.0, 0.0), (-6.0, 1.5, 0.0), (-12.0, 0.0, 0.0)], "those of a and b, are 1.50 m apart"),
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
