"""Whose clock a time is by, told by how late pictures come."""

from __future__ import annotations

import random

import pytest

from agents.camera.mjpeg import LATE, USUAL, TheirClock


def test_a_clock_that_is_ours_is_left_alone() -> None:
    rng, clock = random.Random(1), TheirClock()
    for k in range(100):
        t = 1000.0 + 0.1 * k
        assert clock.ours(t, t + 0.3 * LATE + rng.random() * 0.5 * LATE) == t


@pytest.mark.parametrize("off", [-30.0, -4.5, 2.0])
def test_one_that_is_behind_or_ahead_and_drifts_is_set_right(off: float) -> None:
    rng, clock, errors = random.Random(2), TheirClock(), []
    for k in range(300):
        taken = 1000.0 + 0.1 * k
        theirs = taken + off - 0.01 * 0.1 * k  # a simulator that falls behind by a hundredth
        arrived = taken + USUAL + (rng.expovariate(20.0) if k % 3 else 0.0)
        errors.append(clock.ours(theirs, arrived) - taken)
    assert max(map(abs, errors)) < 0.12
    assert abs(sum(errors[50:]) / len(errors[50:])) < 0.05


def test_a_step_of_our_own_clock_is_forgotten_with_its_time() -> None:
    clock = TheirClock()
    clock.ours(1000.0, 1000.0 + USUAL)
    assert clock.ours(1000.1, 500.0 + USUAL) == pytest.approx(500.0, abs=0.01)
    assert clock.ours(1000.2, 500.1 + USUAL) == pytest.approx(500.1, abs=0.01)
