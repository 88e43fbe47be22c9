"""The motion along a mission's leg."""

from __future__ import annotations

import pytest

from zmav.sim.autopilots.ardupilot.legs import Profile


@pytest.mark.parametrize("length", [0.0, 0.05, 1.0, 8.0, 30.0, 75.0, 500.0])
@pytest.mark.parametrize(("speed", "accel", "jerk"), [(10.0, 2.5, 1.0), (3.0, 2.5, 1.0), (10.0, 2.5, 20.0)])
def test_a_leg_stays_within_its_limits_and_arrives(length: float, speed: float, accel: float, jerk: float) -> None:
    profile, dt = Profile(length, speed, accel, jerk), 0.01
    before = profile.at(0.0)
    for tick in range(1, int(profile.duration / dt) + 2):
        gone, now, push = profile.at(tick * dt)
        assert gone == pytest.approx(before[0] + 0.5 * (before[1] + now) * dt, abs=1e-3)
        assert now == pytest.approx(before[1] + 0.5 * (before[2] + push) * dt, abs=2e-3)
        assert abs(push - before[2]) <= jerk * dt * 1.01 + 1e-9
        assert now <= speed + 1e-6
        assert abs(push) <= accel + 1e-6
        before = (gone, now, push)
    assert profile.at(profile.duration) == (length, 0.0, 0.0)


def test_a_leg_takes_no_longer_than_it_must() -> None:
    # 10 m/s after 2.5 s of jerk each way and 1.5 s of constant acceleration: 6.5 s; 65 m for both ends.
    assert Profile(165.0, 10.0, 2.5, 1.0).duration == pytest.approx(13.0 + 10.0)
    assert Profile(1.0, 10.0, 2.5, 1.0).duration == pytest.approx(4.0 * (1.0 / 2.0) ** (1.0 / 3.0))
