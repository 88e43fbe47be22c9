"""Attitude and place at a picture's own time."""

from __future__ import annotations

import math

import pytest

from zmav.vision.poses import AHEAD, KEEP, Poses


def test_attitude_is_that_of_the_time_between_two_messages() -> None:
    poses = Poses()
    for k in range(40):
        t = 0.04 * k
        poses.turned(t, 0.2 * math.sin(2.0 * t), -0.1 * t, 3.0 + 0.2 * t)  # the heading passes south
        poses.was(t, (t, 2.0 * t, -5.0), (1.0, 2.0, 0.0))
    for t in (0.5, 0.513, 1.0, 1.2345):
        pose = poses.at(t)
        assert pose is not None
        assert pose.roll == pytest.approx(0.2 * math.sin(2.0 * t), abs=2e-4)
        assert pose.pitch == pytest.approx(-0.1 * t, abs=1e-9)
        assert math.cos(pose.yaw - 3.0 - 0.2 * t) == pytest.approx(1.0, abs=1e-9)
        assert -math.pi <= pose.yaw < math.pi
        assert pose.pos == pytest.approx((t, 2.0 * t, -5.0), abs=1e-6)
    assert poses.at(1.2).rate == pytest.approx(math.hypot(0.4 * math.cos(2.4), 0.1), rel=0.05)  # type: ignore[union-attr]


def test_a_place_is_carried_on_with_its_velocity() -> None:
    poses = Poses()
    poses.turned(0.0, 0.0, 0.0, 0.0)
    poses.turned(0.1, 0.0, 0.0, 0.0)
    poses.was(0.0, (0.0, 0.0, -5.0), (2.0, 0.0, 0.0))
    pose = poses.at(0.1)
    assert pose is not None
    assert pose.pos == pytest.approx((0.2, 0.0, -5.0))
    poses.was(0.2, (0.5, 0.0, -5.0), (2.0, 0.0, 0.0))  # between them it went faster: halfway counts both alike
    middle = poses.at(0.1)
    assert middle is not None
    assert middle.pos[0] == pytest.approx((0.2 + 0.3) / 2.0)


def test_of_what_is_too_far_off_nothing_is_said() -> None:
    poses = Poses()
    assert poses.at(0.0) is None
    poses.turned(1.0, 0.0, 0.0, 0.0)
    poses.was(1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert poses.at(1.0) is None, "a single attitude has no rate"
    poses.turned(1.1, 0.1, 0.0, 0.0)
    assert poses.at(0.9) is None
    ahead = poses.at(1.1 + AHEAD - 0.01)
    assert ahead is not None
    assert ahead.roll == pytest.approx(0.1 + (AHEAD - 0.01))
    assert poses.at(1.1 + AHEAD + 0.01) is None
    poses.turned(2.0, 0.0, 0.0, 0.0)
    assert poses.at(1.5) is None, "nothing was heard for almost a second"
    poses.turned(1.9, 9.0, 0.0, 0.0)
    poses.turned(math.nan, 0.0, 0.0, 0.0)
    poses.turned(2.1, math.inf, 0.0, 0.0)
    poses.was(2.2, (math.nan, 0.0, 0.0), (0.0, 0.0, 0.0))
    poses.turned(2.2, 0.0, 0.0, 0.0)
    poses.was(2.1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert poses.at(2.1).roll == 0.0  # type: ignore[union-attr]
    for k in range(1000):
        poses.turned(3.0 + 0.1 * k, 0.0, 0.0, 0.0)
    assert poses.at(3.0 + 99.9 - KEEP - 1.0) is None
    assert len(poses._attitudes) < 40


def test_a_place_needs_no_attitude_and_is_forgotten() -> None:
    poses = Poses()
    poses.was(10.0, (1.0, 2.0, -4.5), (0.5, 0.0, 0.0))
    assert poses.at(10.2) is None
    assert poses.place(10.2) == pytest.approx((1.1, 2.0, -4.5))
    assert poses.place(11.5) is None
