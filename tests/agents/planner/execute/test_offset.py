"""The offset between two clocks: the truth is never outside what is said of it."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from agents.planner.execute.offset import DRIFT, Offset

delays = st.floats(0.0, 2.0)
exchanges = st.lists(st.tuples(delays, delays, st.floats(0.0, 10.0), st.booleans()), min_size=1, max_size=20)


@given(st.floats(-100.0, 100.0), st.floats(-DRIFT, DRIFT), exchanges)
def test_the_truth_is_within_the_error_however_long_each_way_takes(
    ahead: float, drift: float, talk: list[tuple[float, float, float, bool]]
) -> None:
    offset, now = Offset(), 1000.0

    def vehicle(t: float) -> float:
        return t + ahead + drift * (t - 1000.0)

    for there, back, pause, asked in talk:
        stamped = now + there
        came = stamped + back
        if asked:
            offset.answered(now, vehicle(stamped), came)
        else:
            offset.heard(vehicle(stamped), came)
        now = came + pause
        assert abs(vehicle(now) - now - offset.value) <= offset.error(now) + 1e-6


def test_what_is_published_alone_says_too_little() -> None:
    offset = Offset()
    offset.heard(105.0, 100.1)
    assert offset.error(100.2) == math.inf
    offset.answered(100.2, 105.25, 100.3)
    assert offset.error(100.3) < 0.06


def test_a_fixed_value_stays_while_more_is_learned() -> None:
    offset = Offset()
    offset.answered(10.0, 15.0, 10.4)
    offset.fix()
    value = offset.value
    assert value == 4.8
    offset.answered(11.0, 16.001, 11.002)
    assert offset.value == value
    assert 0.18 < offset.error(11.1) < 0.22
    assert offset.ours(offset.vehicle(3.0)) == 3.0


def test_a_clock_that_is_set_is_not_known_any_more() -> None:
    offset = Offset()
    offset.answered(10.0, 15.0, 10.01)
    offset.fix()
    offset.answered(11.0, 36.0, 11.01)
    assert offset.error(11.01) == math.inf


def test_an_answer_before_its_question_says_nothing() -> None:
    offset = Offset()
    offset.answered(10.0, 15.0, 9.0)
    assert offset.error(10.0) == math.inf
