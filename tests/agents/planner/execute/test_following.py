"""How late a vehicle follows and how well it holds its way, learnt from what it says, and bounded whatever it says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.execute.following import LONGEST, SPREAD, SPREADS, USUAL, Following
from agents.planner.model.problem import Floats


def circle(t: float) -> tuple[Floats, Floats]:
    """4 m/s about a point."""
    angle = t / 2.5
    return (
        np.array([10.0 * math.cos(angle), 10.0 * math.sin(angle), 10.0]),
        np.array([-4.0 * math.sin(angle), 4.0 * math.cos(angle), 0.0]),
    )


def fly(following: Following, late: float, off: float = 0.0, seconds: float = 20.0, seed: int = 1) -> Following:
    rng = np.random.default_rng(seed)
    for t in np.arange(0.0, seconds, 0.2):
        following.heard(circle, float(t), circle(float(t) - late)[0] + rng.normal(0.0, off, 3) * math.sqrt(1.0 / 3.0))
    return following


@pytest.mark.parametrize("late", [0.0, 0.2, 0.45, 0.8])
def test_lateness_is_learnt_within_seconds(late: float) -> None:
    assert fly(Following(), late, seconds=4.0).late == pytest.approx(late, abs=0.15)
    assert fly(Following(), late).late == pytest.approx(late, abs=0.03)


def test_what_a_slow_vehicle_is_off_its_way_is_hardly_taken_for_lateness() -> None:
    """At 1 m/s half a metre ahead of its way is half a second."""

    def straight(t: float) -> tuple[Floats, Floats]:
        return np.array([t, 0.0, 10.0]), np.array([1.0, 0.0, 0.0])

    slow = Following("px4")
    for t in np.arange(0.0, 3.0, 0.2):
        slow.heard(straight, float(t), straight(float(t) - 0.45)[0] + np.array([0.5, 0.0, 0.0]))
    assert slow.late == pytest.approx(0.45, abs=0.2)
    for t in np.arange(3.0, 60.0, 0.2):  # for long enough it is
        slow.heard(straight, float(t), straight(float(t))[0])
    assert slow.late == pytest.approx(0.0, abs=0.1)


def test_what_is_usual_for_an_autopilot_is_where_it_begins() -> None:
    px4 = Following("px4")
    assert (px4.late, px4.spread) == pytest.approx(USUAL["px4"])
    assert Following("ardupilot").late == Following(None).late == 0.0
    assert Following().spread == pytest.approx(SPREAD)


@pytest.mark.parametrize("off", [0.1, 0.2, 0.4])
def test_what_is_left_is_how_well_it_holds_its_way(off: float) -> None:
    assert fly(Following(), 0.45, off, seconds=60.0).spread == pytest.approx(off, rel=0.3)


def test_neither_is_ever_beyond_its_bounds() -> None:
    wild = fly(Following(), 5.0, 30.0, seconds=120.0)
    assert 0.0 <= wild.late <= LONGEST
    assert SPREADS[0] <= wild.spread <= SPREADS[1]
    ahead = fly(Following(), -2.0, seconds=60.0)
    assert ahead.late == pytest.approx(0.0, abs=0.01)


def test_one_look_that_is_wrong_changes_little() -> None:
    following = fly(Following(), 0.3, 0.1, seconds=30.0)
    late, spread = following.late, following.spread
    following.heard(circle, 30.0, np.array([500.0, 0.0, 0.0]))
    assert following.late == pytest.approx(late, abs=0.02)
    assert following.spread == pytest.approx(spread, rel=0.05)


def test_a_vehicle_that_hovers_says_nothing_of_how_late_it_is() -> None:
    following = Following("px4")
    for t in range(100):
        following.heard(lambda at: (np.zeros(3), np.zeros(3)), float(t), np.array([0.3, 0.0, 0.0]))
    assert following.late == USUAL["px4"][0]
    assert following.spread == pytest.approx(0.3, abs=0.02)


def test_a_place_that_is_none_teaches_nothing() -> None:
    following = fly(Following(), 0.3, 0.1, seconds=30.0)
    late, spread = following.late, following.spread
    with np.errstate(over="ignore", invalid="ignore"):
        for place in (np.full(3, np.nan), np.array([1e308, -1e308, 1e308]) * 10.0):
            following.heard(circle, 30.0, place)
    assert (following.late, following.spread) == (late, spread)
