"""The filter of a target against what it truly does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.follower.tracker import FIRST_SPEED, SOON, SURE, Tracker

NOISE = (0.0025, 0.0, 0.0025)


def truth(t: float) -> tuple[float, float]:
    return 3.0 + 1.0 * t, -2.0 - 0.5 * t


def test_a_straight_way_is_known_better_than_a_single_sight() -> None:
    rng, tracker = np.random.default_rng(1), Tracker(accel=0.2)
    errors, raw = [], []
    for k in range(200):
        t = 0.1 * k
        north, east = truth(t) + rng.normal(0.0, 0.05, 2)
        assert tracker.see(t, (north, east), NOISE) is (k > 0)
        if k > 50:
            estimate = tracker.at(t)
            assert estimate is not None
            errors.append(math.dist(estimate.pos, truth(t)))
            raw.append(math.dist((north, east), truth(t)))
    assert np.mean(errors) < 0.7 * np.mean(raw)
    ahead = tracker.at(19.9 + 2.0)
    assert ahead is not None
    assert math.dist(ahead.pos, truth(21.9)) < 0.4
    assert ahead.vel == pytest.approx([1.0, -0.5], abs=0.15)


def test_its_uncertainty_is_what_it_says_and_grows_unseen() -> None:
    """Normalised errors of many runs: the filter is neither too sure nor too shy (Bar-Shalom, section 5.4)."""
    rng, normalised = np.random.default_rng(2), []
    for _ in range(200):
        tracker, place, vel = Tracker(accel=0.8), np.zeros(2), rng.normal(0.0, 1.0, 2)
        for k in range(40):
            dt = 0.1
            push = rng.normal(0.0, 0.8 / math.sqrt(dt), 2)
            place, vel = place + vel * dt + push * dt * dt / 2.0, vel + push * dt
            tracker.see(dt * k, tuple(place + rng.normal(0.0, 0.05, 2)), NOISE)
        estimate = tracker.at(3.9)
        assert estimate is not None
        normalised.append(float(np.sum((estimate.pos - place) ** 2)) / estimate.sigma**2)
    assert 1.4 < np.mean(normalised) < 2.6
    sigmas = [estimate.sigma for dt in (0.0, 0.5, 1.0, 2.0) if (estimate := tracker.at(3.9 + dt)) is not None]
    assert len(sigmas) == 4
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 5.0 * sigmas[0]


def test_what_is_far_off_is_not_believed_until_it_stays_there() -> None:
    tracker = Tracker()
    for k in range(20):
        tracker.see(0.1 * k, truth(0.1 * k), NOISE)
    assert not tracker.see(2.0, (40.0, 40.0), NOISE)
    assert not tracker.see(2.1, (-40.0, 7.0), NOISE)
    assert tracker.see(2.2, truth(2.2), NOISE)
    believed = [tracker.see(2.3 + 0.1 * k, (8.0 + 0.05 * k, 8.0), NOISE) for k in range(SURE)]
    assert believed == [False] * (SURE - 1) + [True]
    estimate = tracker.at(2.3 + 0.1 * (SURE - 1))
    assert estimate is not None
    assert math.dist(estimate.pos, (8.0 + 0.05 * (SURE - 1), 8.0)) < 0.1
    assert estimate.vel == pytest.approx([0.5, 0.0], abs=0.01)


def test_a_target_begins_with_two_sights_that_agree() -> None:
    tracker = Tracker()
    assert not tracker.see(50.0, (40.0, 40.0), NOISE)
    assert not tracker.see(0.0, (0.0, 0.0), NOISE), "a clock that was set back"
    assert not tracker.see(0.1, (5.0, 0.0), NOISE), "another place"
    assert not tracker.see(0.1 + SOON, (5.0, 0.0), NOISE), "too late"
    assert tracker.t is None
    assert tracker.at(0.2 + SOON) is None
    assert tracker.see(0.2 + SOON, (5.1, 0.0), NOISE)
    estimate = tracker.at(0.2 + SOON)
    assert estimate is not None
    assert estimate.pos == pytest.approx([5.08, 0.0], abs=0.04)
    assert 0.5 < float(estimate.vel[0]) < 1.0, "not all of what two sights so near each other say"


@pytest.mark.parametrize(
    ("speed", "every", "told"), [(1.0, 2.0, None), (1.0, 2.0, 1.0), (5.0, 0.5, 5.0), (5.0, 2.0, 5.0)]
)
def test_few_pictures_and_a_fast_target_are_enough(speed: float, every: float, told: float | None) -> None:
    tracker = Tracker(0.3)
    word = None if told is None else (told, 0.0)
    assert [tracker.see(every * k, (speed * every * k, 0.0), NOISE, word) for k in range(4)] == [
        False,
        True,
        True,
        True,
    ]


def test_a_false_first_sight_gives_the_target_no_speed() -> None:
    """3 m beside a target that says that it stands, half a second before it is seen."""
    tracker = Tracker(0.3)
    assert not tracker.see(0.0, (3.0, 0.0), NOISE, (0.0, 0.0))
    believed = [tracker.see(0.5 + 0.1 * k, (0.0, 0.0), NOISE, (0.0, 0.0)) for k in range(SURE)]
    assert believed == [False] * (SURE - 1) + [True]
    estimate = tracker.at(1.0)
    assert estimate is not None
    assert np.abs(estimate.vel).max() < 0.1


def test_bad_sights_change_nothing() -> None:
    tracker = Tracker()
    assert tracker.at(0.0) is None
    assert not tracker.see(1.0, (math.nan, 0.0), NOISE)
    assert not tracker.see(math.inf, (0.0, 0.0), NOISE)
    assert not tracker.see(1.0, (0.0, 0.0), (math.nan, 0.0, 1.0))
    assert tracker.t is None
    assert not tracker.see(0.9, (2.0, 3.0)), "the first of all"
    assert tracker.see(1.0, (2.0, 3.0))
    assert not tracker.see(1.0, (2.0, 3.0)), "the same picture again"
    assert not tracker.see(0.5, (2.0, 3.0)), "an older one"
    assert tracker.see(1.1, (2.0, 3.0), (0.01, 5.0, 0.01)), "a covariance that cannot be is cut to one that can"
    estimate = tracker.at(1.05)
    assert estimate is not None
    assert np.isfinite(estimate.pos).all()
    tracker.forget()
    assert tracker.at(2.0) is None
    assert FIRST_SPEED > 0.0


def test_what_the_target_says_of_its_speed_outweighs_the_first_few_sights() -> None:
    """From a vehicle that brakes, leaning, the first sights move with it: here by 2 m/s for a quarter of a second."""
    speeds = []
    for told in ((0.5, 0.0), None, (math.nan, 0.0)):
        tracker = Tracker(0.3)
        for k in range(5):
            tracker.see(k / 15.0, (2.5 * k / 15.0, 0.0), NOISE, told)
        estimate = tracker.at(4 / 15.0)
        assert estimate is not None
        speeds.append(float(estimate.vel[0]))
    assert 0.5 < speeds[0] < 1.0
    assert speeds[1] == speeds[2] > 2.0
    # What goes on so leaves the gate, and begins anew with what is said.
    tracker = Tracker(0.3)
    for k in range(15):
        tracker.see(k / 15.0, (5.5 * k / 15.0, 0.0), NOISE, (0.5, 0.0))
    estimate = tracker.at(14 / 15.0)
    assert estimate is not None
    assert float(estimate.vel[0]) < 3.5
