"""The first plan: its lines keep their limits, and its levels keep vehicles apart at every instant."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.planner.straight import Line, Route, rotate
from zmav.errors import BadInput
from zmav.wire import Vector

metres = st.floats(-2000.0, 2000.0, allow_nan=False)
places = st.tuples(metres, metres, metres)
lines = st.builds(Line, places, places, speed=st.floats(0.5, 20.0), acceleration=st.floats(0.2, 10.0))
shares = st.floats(0.0, 1.0)
EPS = 1e-6


@given(lines)
def test_a_line_is_from_start_to_goal_exactly(line: Line) -> None:
    assert line.at(0.0) == line.start == line.at(-1.0)
    assert line.at(line.duration) == line.goal == line.at(line.duration + 1e6)


@given(lines, shares, shares)
def test_a_line_keeps_its_speed(line: Line, one: float, other: float) -> None:
    a, b = sorted((one * line.duration, other * line.duration))
    assert math.dist(line.at(a), line.at(b)) <= line.speed * (b - a) * (1 + EPS) + EPS


@given(lines, shares)
def test_a_line_keeps_its_acceleration_and_rests_at_both_ends(line: Line, share: float) -> None:
    """Within any half a second the velocity changes by no more than the acceleration allows, the ends included."""
    t, h = share * (line.duration + 1.0) - 0.5, 0.25
    before, now, after = line.at(t - h), line.at(t), line.at(t + h)
    change = math.hypot(*(a - 2 * b + c for a, b, c in zip(before, now, after, strict=True))) / h**2
    assert change <= line.acceleration * (1 + EPS) + 1e-5


@given(lines, shares)
def test_a_line_is_straight_and_never_turns_back(line: Line, share: float) -> None:
    point = line.at(share * line.duration)
    assert math.dist(line.start, point) + math.dist(point, line.goal) == pytest.approx(line.length, abs=1e-6)
    later = line.at(share * line.duration + 0.1)
    assert math.dist(line.start, later) >= math.dist(line.start, point) - EPS


def test_a_long_and_a_short_line_take_the_time_the_textbook_says() -> None:
    long = Line((0.0, 0.0, 0.0), (40.0, 0.0, 0.0), speed=4.0, acceleration=2.0)
    assert long.duration == pytest.approx(40.0 / 4.0 + 4.0 / 2.0)
    assert long.at(long.duration / 2) == pytest.approx((20.0, 0.0, 0.0))
    assert long.at(1.0) == pytest.approx((1.0, 0.0, 0.0))
    short = Line((0.0, 0.0, 0.0), (0.0, 2.0, 0.0), speed=4.0, acceleration=2.0)
    assert short.duration == pytest.approx(2.0)
    still = Line((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
    assert (still.duration, still.at(5.0)) == (0.0, (1.0, 2.0, 3.0))


@st.composite
def fleets(draw: st.DrawFn) -> dict[str, Vector]:
    starts = draw(st.lists(places, min_size=2, max_size=8))
    assume(all(math.dist(a[:2], b[:2]) >= 2.0 for a, b in itertools.combinations(starts, 2)))
    return {f"quad{i}": start for i, start in enumerate(starts, start=1)}


@given(fleets(), st.floats(1.0, 20.0), st.floats(1.0, 10.0), shares)
def test_levels_are_apart_at_every_instant(
    starts: dict[str, Vector], lowest: float, spacing: float, share: float
) -> None:
    routes = rotate(starts, lowest, spacing)
    t = share * max(route.line.duration for route in routes.values())
    downs = [route.line.at(t)[2] for route in routes.values()]
    for a, b in itertools.combinations(downs, 2):
        assert abs(a - b) >= spacing - EPS


@given(fleets(), st.floats(1.0, 20.0))
def test_everyone_goes_to_the_next_ones_place_at_a_height_it_can_climb_to(
    starts: dict[str, Vector], lowest: float
) -> None:
    routes = rotate(starts, lowest)
    names = list(starts)
    assert list(routes) == names
    for name, following in zip(names, [*names[1:], names[0]], strict=True):
        route: Route = routes[name]
        assert route.line.start[:2] == starts[name][:2]
        assert route.line.goal[:2] == starts[following][:2]
        assert route.line.start[2] == route.line.goal[2]
        assert route.height >= lowest - EPS
        assert starts[name][2] - route.height == pytest.approx(route.line.start[2])


@pytest.mark.parametrize(
    ("starts", "words"),
    [
        ({}, "two vehicles or more"),
        ({"quad1": (0.0, 0.0, 0.0)}, "two vehicles or more"),
        ({"quad1": (0.0, 0.0, 0.0), "quad2": (1.0, 1.0, 0.0)}, "quad1 and quad2 start 1.4 m apart"),
        ({"quad1": (0.0, 0.0, 0.0), "quad2": (0.0, 0.0, -50.0)}, "quad1 and quad2 start 0.0 m apart"),
        ({"quad1": (0.0, 0.0, 0.0), "quad2": (math.nan, 9.0, 0.0)}, "quad2 starts at .*no place"),
        ({"quad1": (0.0, math.inf, 0.0), "quad2": (9.0, 9.0, 0.0)}, "quad1 starts at .*no place"),
    ],
)
def test_bad_starts_are_named(starts: dict[str, Vector], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        rotate(starts)
