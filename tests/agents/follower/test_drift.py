"""How far a position estimate has wandered, from positions and velocities alone."""

from __future__ import annotations

import math

import pytest

from agents.follower.drift import KEPT, LONGEST, PositionDrift


def circle(t: float) -> tuple[float, float]:
    return 3.0 * math.cos(t), 3.0 * math.sin(t)


def feed(drift: PositionDrift, t: float, off: tuple[float, float] = (0.0, 0.0), clock: float = 0.0) -> None:
    """A vehicle flies a circle, and is told ``off`` from where it is; ``clock``: s by which its clock was set."""
    north, east = circle(t)
    drift.feed(t + clock, t, (north + off[0], east + off[1], -5.0), (-east, north, 0.0))


def test_what_it_has_flown_is_no_drift_and_what_it_has_not_is() -> None:
    drift = PositionDrift()
    assert drift.at(7.0) == (0.0, 0.0)
    for k in range(101):
        feed(drift, 0.1 * k, (0.2 * 0.1 * k, 0.0 if k < 50 else -4.0))
    assert drift.at(10.0) == pytest.approx((2.0, -4.0), abs=0.01)
    assert drift.at(99.0) == drift.at(10.0)
    assert drift.at(9.05) == pytest.approx((1.81, -4.0), abs=0.01), "between two states"
    assert drift.at(0.0) == drift.at(10.0 - KEPT + 0.1), "longer ago than it is kept"


def test_a_gap_and_an_older_state_tell_nothing() -> None:
    drift = PositionDrift()
    feed(drift, 1.0)
    feed(drift, 1.5, (0.5, 0.0))
    before = drift.at(1.5)
    assert before == pytest.approx((0.5, 0.0), abs=0.05)
    feed(drift, 1.4, (9.0, 9.0))
    feed(drift, 1.5, (9.0, 9.0))
    assert drift.at(1.5) == before
    feed(drift, 1.5 + LONGEST, (7.0, 7.0))
    assert drift.at(3.0) == before


@pytest.mark.parametrize("clock", [-990.0, -4.0, -2.0, -0.25, 0.6, 100.0])
def test_a_clock_that_is_set_is_no_drift(clock: float) -> None:
    drift = PositionDrift()
    for k in range(40):
        feed(drift, 1000.0 + 0.2 * k, (1.0 if k > 10 else 0.0, 0.0), clock if k > 20 else 0.0)
    assert drift.at(1007.8 + clock) == pytest.approx((1.0, 0.0), abs=0.05)
    feed(drift, 1008.0, (3.0, 0.0), clock)
    assert drift.at(1008.0 + clock) == pytest.approx((3.0, 0.0), abs=0.05)
