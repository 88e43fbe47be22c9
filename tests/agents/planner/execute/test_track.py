"""A plan's curve, the clock along it, and the points of a segment against what the vehicle makes of them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.execute.track import (
    DENSE,
    EASE,
    NEAR,
    CommonClock,
    Profile,
    Track,
    behind,
    braked,
    crept,
    flown,
    join,
    knots,
    onward,
)
from tests.agents.planner.execute.virtual import ORIGIN, carousel, line
from zmav import wire
from zmav.services.authority.trajectory import MAX_POINTS, Segment

SLOPE = 0.5
seeds = st.integers(0, 10_000)


def wiggle(seed: int) -> Track:
    """A random smooth motion, with a stand in its middle."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.uniform(-15.0, 15.0, (3, 3)), axis=0)
    first, second = line(places[0], places[1]), line(places[1], places[2], speed=5.0, accel=2.5, delay=2.0)
    second[:, 0] += first[-1, 0]
    return Track(np.vstack((first, second[1:])))


@given(seeds)
def test_a_track_is_near_its_samples_and_exact_at_its_ends(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = line(rng.uniform(-20.0, 20.0, 3), rng.uniform(-20.0, 20.0, 3), speed=5.0, accel=2.5)
    track = Track(motion)
    s = np.linspace(0.0, track.s[-1], 300)
    place, _ = track.at(s)
    late = s - EASE / 2.0
    meant = np.column_stack([np.interp(late, motion[:, 0], motion[:, axis]) for axis in (1, 2, 3)])
    assert np.linalg.norm(place - meant, axis=1).max() < 2.5 * EASE**2 / 24.0 + 0.005
    assert place[0] == pytest.approx(motion[0, 1:])
    assert place[-1] == pytest.approx(motion[-1, 1:])
    assert track.end == pytest.approx(motion[-1, 0] + EASE, abs=0.11)


def test_easing_takes_the_steps_out_of_the_acceleration() -> None:
    motion = line(np.zeros(3), np.array([30.0, 0.0, 0.0]), speed=5.0, accel=2.5)

    def jerk(track: Track) -> float:
        _, velocity = track.at(np.arange(0.0, track.end, 0.1))
        return float(np.abs(np.diff(velocity[:, 0], 2)).max() / 0.1**2)

    assert jerk(Track(motion)) < 7.0 < 12.0 < jerk(Track(motion, ease=0.0))


@given(seeds)
def test_a_vehicle_flies_what_was_checked(seed: int) -> None:
    """The vehicle's own interpolation of the points against our samples of it, and against the plan."""
    track = wiggle(seed)
    rng = np.random.default_rng(seed)
    profile = onward(
        Profile.resting(0.0, 100.0), 101.0, CommonClock(102.0, 0.0), track.end * rng.uniform(0.3, 1.0), track.end, SLOPE
    )
    if profile is None:
        return
    rows = knots(track, profile, 101.0)
    points = [wire.SegmentPoint(t=r[0], pos=tuple(r[1:4]), vel=tuple(r[4:7])) for r in rows.tolist()]
    segment = Segment(points, ORIGIN, 101.0)
    assert len(points) <= MAX_POINTS
    assert math.dist(points[-1].vel or (9.0, 9.0, 9.0), (0.0, 0.0, 0.0)) == 0.0
    samples = flown(rows)
    assert np.diff(samples[:, 0]).max() <= DENSE + 1e-9
    for k, piece in enumerate(segment.pieces):
        t = piece.start + rng.uniform(0.0, 1.0) * piece.step
        place = piece.at(t)[0]
        ours = [np.interp(t, samples[:, 0], samples[:, axis]) for axis in (1, 2, 3)]
        assert math.dist(place, ours) < 0.008, k
        assert math.dist(place, track.at(profile.at(np.array([t]))[0])[0][0]) < 2.0 * NEAR


@given(st.floats(0.0, 30.0), st.floats(0.0, 1.0), st.floats(-3.0, 12.0), st.floats(0.4, 1.0))
def test_who_joins_the_common_clock_is_on_it_or_as_far_behind_as_was_said(
    s: float, rate: float, ahead: float, pace: float
) -> None:
    d = 50.0
    common = CommonClock(d, s - ahead, pace)
    pieces, t, at = join(d, s, rate, common, SLOPE)
    late = behind(d, s, rate, common, SLOPE)
    assert at - common.at(t) == pytest.approx(-late, abs=1e-4)
    assert late == 0.0 or ahead < 0.0 or rate < pace
    assert all(0.0 <= piece[2] <= max(rate, pace) + 1e-9 for piece in pieces)
    assert t >= d
    for (t0, s0, r0, a0), (t1, s1, r1, _) in pairwise([*pieces, (t, at, pace, 0.0)]):
        assert s0 + (r0 + 0.5 * a0 * (t1 - t0)) * (t1 - t0) == pytest.approx(s1, abs=1e-6)
        if s > 0.0 or rate > 0.0:
            assert r0 + a0 * (t1 - t0) == pytest.approx(r1, abs=1e-6)


@given(st.floats(2.0, 20.0), st.floats(0.3, 1.0))
def test_a_profile_comes_to_rest_where_it_was_told(stop: float, pace: float) -> None:
    start = Profile.resting(0.0, 0.0)
    profile = onward(start, 1.0, CommonClock(1.0, 0.0, pace), stop, 30.0, SLOPE)
    assert profile is not None
    assert profile.stop == pytest.approx(stop)
    t = np.linspace(0.0, profile.rest_at + 1.0, 2000)
    s, rate = profile.at(t)
    assert np.all(np.diff(s) >= -1e-9)
    summed = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))))
    assert np.abs(summed - s).max() < 0.02
    soon = braked(profile, 1.5, SLOPE)
    assert soon.rest_at <= profile.rest_at + 1e-9
    assert soon.stop <= profile.stop + 1e-9


def test_inching_on_ends_where_it_was_told_and_from_rest_only() -> None:
    profile = crept(Profile.resting(4.0, 0.0), 10.0, 4.3, SLOPE)
    assert profile is not None
    (s,), (rate,) = profile.at(np.array([profile.rest_at]))
    assert (s, rate) == (pytest.approx(4.3), 0.0)
    assert profile.at(np.array([10.0]))[0] == pytest.approx(4.0)
    moving = onward(Profile.resting(0.0, 0.0), 1.0, CommonClock(1.0, 0.0), 20.0, 30.0, SLOPE)
    assert moving is not None
    assert crept(moving, 5.0, 6.0, SLOPE) is None


def test_a_vehicle_that_stays_has_a_track_too() -> None:
    track = Track(np.array([[0.0, 1.0, 2.0, 3.0]]))
    assert (track.speed, track.end) == (0.0, 0.0)
    assert track.at(np.array([0.0, 5.0]))[0].tolist() == [[1.0, 2.0, 3.0]] * 2
    assert Track(carousel(2, 5.0)["v0"]).speed > 3.0
