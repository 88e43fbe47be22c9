"""The pace along ways: as fast as the limits allow and no faster, at rest at the ends and in sharp corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planner.goals import timing
from agents.planner.goals.curves import dense, lengths_of, rounded
from agents.planner.model.problem import Floats


def limits(speed: float = 5.0, accel: float = 2.5) -> timing.Limits:
    one = np.ones(1)
    return timing.Limits(speed * one, accel * one, 2.0 * one, 1.5 * one)


def judged(samples: Floats, speed: float = 5.0, accel: float = 2.5) -> float:
    """The time that it takes, of samples that break no limit."""
    t, places = samples[:, 0], samples[:, 1:]
    assert np.diff(t).max() <= 0.2
    velocity = np.diff(places, axis=0) / np.diff(t)[:, None]
    assert np.linalg.norm(velocity, axis=1).max() <= 1.001 * speed
    assert velocity[:, 2].min() >= -1.51 and velocity[:, 2].max() <= 2.01
    still = np.zeros((1, 3))
    change = np.diff(np.concatenate((still, velocity, still)), axis=0) / np.diff(t).mean()
    change[[0, -1]] *= 2.0
    # Where it stops in a corner, one difference holds the end of one way and the beginning of another.
    assert np.linalg.norm(change, axis=1).max() <= 1.2 * accel
    return float(t[-1])


def test_a_straight_way_takes_a_trapezoid() -> None:
    way = dense(np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]]), 0.25)
    took = judged(timing.fly(way[:, None], limits())[:, 0])
    assert took == pytest.approx(50.0 / 5.0 + 5.0 / (2.5 * timing.SHARE), rel=0.01)


def test_it_stops_in_a_sharp_corner_and_not_in_a_round_one() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [30.0, 30.0, 0.0]])
    sharp = judged(timing.fly(dense(corners, 0.25)[:, None], limits())[:, 0])
    smooth = judged(timing.fly(rounded(corners, 10.0, 0.25)[:, None], limits())[:, 0])
    assert sharp == pytest.approx(2.0 * (30.0 / 5.0 + 5.0 / (2.5 * timing.SHARE)), rel=0.02)
    assert smooth < sharp - 2.0


@settings(max_examples=40)
@given(
    corners=st.lists(st.tuples(*[st.integers(-20, 20)] * 3), min_size=2, max_size=6, unique=True),
    radius=st.sampled_from([0.0, 0.3, 2.0, 10.0]),
)
def test_no_way_breaks_a_limit(corners: list[tuple[int, int, int]], radius: float) -> None:
    path = np.array(corners, dtype=np.float64)
    way = rounded(path, radius, 0.2) if radius > 0.0 else dense(path, 0.2)
    samples = timing.fly(way[:, None], limits())[:, 0]
    judged(samples)
    assert samples[-1, 1:] == pytest.approx(path[-1], abs=1e-5)
    assert lengths_of(samples[:, 1:])[-1] <= lengths_of(path)[-1] + 1e-3


def test_all_keep_one_pace_and_nobody_breaks_a_limit() -> None:
    way = dense(np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]), 0.25)
    both = np.stack((way, 2.0 * way), axis=1)
    two = np.ones(2)
    samples = timing.fly(both, timing.Limits(5.0 * two, 2.5 * two, two, two))
    judged(samples[:, 1])
    assert samples[:, 1, 1] == pytest.approx(2.0 * samples[:, 0, 1], abs=1e-5)


def test_a_corner_is_passed_as_near_as_asked() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [40.0, 40.0, 0.0]])
    for cut in (0.2, 1.0, 3.0):
        curve = rounded(corners, np.inf, 0.05, cut=cut)
        assert np.linalg.norm(curve - corners[1], axis=1).min() == pytest.approx(cut, abs=0.02)
