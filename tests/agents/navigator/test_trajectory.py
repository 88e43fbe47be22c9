"""Trajectories: within every limit at every moment, the same across the borders of segments, and to rest when told."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agents.navigator.path import Array
from agents.navigator.routes import Route, shape
from agents.navigator.trajectory import CLOSEST, Leg, Limits, Trajectory, plan
from zmav import wire
from zmav.errors import BadInput
from zmav.services.authority.trajectory import MAX_POINTS, Segment

ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
T0 = 1.7e9
STEP = 0.002
ROUNDING = 1.0 + 1e-6
"""limits are met, and not only kept away from"""

limits = st.builds(Limits, st.floats(0.1, 3.0), st.floats(0.2, 4.0), st.floats(0.3, 20.0))
routes = st.builds(
    lambda name, dwell, reached: shape(name, (1.0, 2.0, -6.0), 0.7, dwell=dwell).reached_from(*reached),
    st.sampled_from(["ev3", "square", "circle", "lemniscate"]),
    st.sampled_from([0.0, 1.0]),
    st.tuples(st.sampled_from([(0.0, 0.0, -5.0), (40.0, -3.0, -20.0), (1.0, 2.3, -6.1)]), st.sampled_from([0.0, 2.0])),
)


LEFT = 1e-4
"""m/s², for each (m/s³)^(2/3) of the jerk: what is left of its acceleration where a way ends, when the distance is
rounded to its end and the way is the next"""


def norm(rows: Array) -> Array:
    found: Array = np.linalg.norm(rows, axis=1)
    return found


def moments(trajectory: Trajectory, most: int = 60_000) -> Array:
    return np.arange(0.0, trajectory.duration, max(STEP, trajectory.duration / most))


def assert_within(trajectory: Trajectory, t: Array, over: float = ROUNDING) -> None:
    """Speed and acceleration by what it says, jerk by how the acceleration changes."""
    moment, allowed = trajectory.at(t), trajectory.limits
    assert norm(moment.vel).max() <= allowed.speed * over
    assert norm(moment.acc).max() <= allowed.accel * over
    assert norm(np.diff(moment.acc, axis=0)).max() <= allowed.jerk * over * (t[1] - t[0]) + LEFT * allowed.jerk ** (
        2 / 3
    )


@settings(max_examples=60)
@given(route=routes, allowed=limits)
def test_no_limit_is_exceeded_anywhere(route: Route, allowed: Limits) -> None:
    trajectory = Trajectory(route, allowed)
    t = moments(trajectory)
    assert_within(trajectory, t)
    ends = trajectory.at(np.array([0.0, trajectory.duration]))
    assert norm(ends.vel).max() < 1e-9
    assert ends.along == pytest.approx([0.0, route.starts[-1]])


@settings(max_examples=60)
@given(route=routes, allowed=limits)
def test_velocity_and_acceleration_are_the_changes_of_place_and_velocity(route: Route, allowed: Limits) -> None:
    trajectory = Trajectory(route, allowed)
    t = moments(trajectory)
    moment, step = trajectory.at(t), t[1] - t[0]
    # A difference of two is the rate in their middle, but for what the next derivative changes of it.
    vel, acc = (0.5 * (rows[1:] + rows[:-1]) for rows in (moment.vel, moment.acc))
    assert norm(np.diff(moment.pos, axis=0) / step - vel).max() < allowed.jerk * step**2 + 1e-5
    assert norm(np.diff(moment.vel, axis=0) / step - acc).max() < allowed.jerk * step + 1e-5


def test_a_straight_way_is_flown_as_fast_as_the_limits_allow() -> None:
    trajectory = Trajectory(shape("square", side=10.0), Limits(1.0, 1.0, 2.0))
    # 10 m at 1 m/s, and for each ramp half of v/a + a/j lost: 10 + 1.5 s a side.
    assert trajectory.duration == pytest.approx(4 * 11.5)
    at_corners = trajectory.at(np.array([0.0, 11.5, 23.0, 34.5, 46.0]))
    assert norm(at_corners.vel).max() < 1e-6
    assert at_corners.along == pytest.approx([0.0, 10.0, 20.0, 30.0, 40.0])


def test_dwells_are_kept() -> None:
    sharp = Trajectory(shape("square", side=10.0), Limits())
    dwelling = Trajectory(shape("square", side=10.0, dwell=2.0), Limits())
    assert dwelling.duration == pytest.approx(sharp.duration + 3 * 2.0)


@settings(max_examples=60)
@given(route=routes, allowed=limits, share=st.floats(0.0, 1.0))
@example(route=shape("ev3", (1.0, 2.0, -6.0), 0.7, dwell=0.0), allowed=Limits(1.0, 1.0, 0.5), share=0.5)
def test_it_brakes_within_the_limits_and_stays_on_its_way(route: Route, allowed: Limits, share: float) -> None:
    trajectory = Trajectory(route, allowed)
    begin = share * trajectory.duration
    braked = trajectory.braked(begin)
    t = np.arange(0.0, begin, max(0.01, begin / 2000))
    assert braked.at(t).pos == pytest.approx(trajectory.at(t).pos, abs=1e-9)
    assert braked.duration <= max(trajectory.duration, begin) + 1e-6
    assert norm(braked.at(np.array([braked.duration])).vel)[0] < 1e-6
    ahead = np.arange(begin, braked.duration, max(STEP, (braked.duration - begin) / 5000))
    if len(ahead) > 1:
        assert_within(braked, ahead, 1.0 + 1e-3)
        assert (np.diff(braked.at(ahead).along) >= -1e-9).all()


def flown(points: list[wire.SegmentPoint], t: Array) -> tuple[Array, Array]:
    """What a vehicle makes of a segment: places and velocities at the times, (N, 3) each."""
    segment = Segment(points, ORIGIN, now=points[0].t)
    index = np.clip(np.searchsorted([p.t for p in points], t, side="right") - 1, 0, len(segment.pieces) - 1)
    found = [segment.pieces[k].at(float(at)) for k, at in zip(index, t, strict=True)]
    return np.array([each[0] for each in found]), np.array([each[1] for each in found])


@settings(max_examples=40)
@given(route=routes, allowed=limits, begin=st.floats(0.0, 1.0), gap=st.floats(1.0, 19.0))
def test_nothing_jumps_where_one_segment_takes_the_place_of_another(
    route: Route, allowed: Limits, begin: float, gap: float
) -> None:
    trajectory = Trajectory(route, allowed)
    first = begin * trajectory.duration
    second = min(first + gap, trajectory.duration)
    one, two = (trajectory.segment(t, T0) for t in (first, second))
    for points in (one, two):
        assert 2 <= len(points) <= MAX_POINTS
        assert min(b.t - a.t for a, b in pairwise(points)) >= CLOSEST - 1e-5
        assert points[-1].vel == (0.0, 0.0, 0.0)
    t = np.arange(second, min(first + 20.0, trajectory.duration), 0.05)
    if not len(t):
        return
    meant = trajectory.at(t)
    for points in (one, two):
        place, vel = flown(points, T0 + t)
        assert norm(place - meant.pos).max() < 2e-3
        assert norm(vel - meant.vel).max() < 2e-2


def test_a_segment_ends_at_rest_on_the_way_within_what_a_vehicle_takes() -> None:
    trajectory = Trajectory(shape("circle", radius=20.0), Limits())
    points = trajectory.segment(5.0, T0)
    assert 20.0 < points[-1].t - points[0].t < 25.0
    assert math.hypot(*points[-1].pos[:2]) == pytest.approx(20.0, abs=1e-5)
    rest = trajectory.segment(trajectory.duration - 3.0, T0)
    assert rest[-1].t == pytest.approx(T0 + trajectory.duration)
    assert trajectory.segment(trajectory.duration + 1.0, T0)[0].pos == pytest.approx(rest[-1].pos)


def test_a_law_that_has_no_room_for_its_speed_does_with_less() -> None:
    law = plan([Leg(0.02, 5.0, 1.0, 2.0)])
    t = np.linspace(0.0, law.end, 1000)
    s, v, _ = law.at(t)
    assert s[-1] == pytest.approx(0.02)
    assert v.max() < 0.2


@pytest.mark.parametrize(("name", "value"), [("speed", 0.0), ("accel", math.nan), ("jerk", -1.0), ("speed", 1e6)])
def test_limits_that_limit_nothing_or_everything_are_refused(name: str, value: float) -> None:
    with pytest.raises(BadInput, match="expected") as refused:
        Limits(**{name: value})
    assert refused.value.detail["field"] == name
