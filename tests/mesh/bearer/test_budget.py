"""Budgets as people write them, and what a token bucket lets through."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesh.bearer.shaper import LARGEST, Bucket
from zmav.config.mesh import parse_budget
from zmav.errors import BadConfig


@pytest.mark.parametrize(
    ("text", "rate"),
    [("60 kB/s", 60e3), ("60kB/s", 60e3), ("1 Mbit/s", 125e3), ("57600 bit/s", 7200.0), ("0.5 MB/s", 5e5)],
)
def test_a_budget_is_read(text: str, rate: float) -> None:
    assert parse_budget(text) == rate


@pytest.mark.parametrize(
    "text",
    ["", "60", "60 kB", "60 kb", "fast", "-1 kB/s", "0 kB/s", "4.9 kB/s", "60 kB/min", "1e3 kB/s", "nan kB/s", "/s"],
)
def test_what_is_no_budget_is_refused_by_its_field(text: str) -> None:
    with pytest.raises(BadConfig) as refused:
        parse_budget(text, "radios[0].budget")
    assert refused.value.detail["field"] == "radios[0].budget"
    assert "60 kB/s" in str(refused.value) and "5000 B/s at least" in str(refused.value)


@given(
    rate=st.floats(5e3, 1e6),
    sizes=st.lists(st.integers(60, LARGEST), min_size=1, max_size=200),
    pauses=st.lists(st.floats(0.0, 0.5), min_size=1, max_size=20),
)
def test_no_window_holds_more_than_the_budget_and_the_bucket(
    rate: float, sizes: list[int], pauses: list[float]
) -> None:
    """However it is asked: at once, or after pauses in which the bucket fills."""
    now, bucket, left = 100.0, Bucket(rate, 100.0), []
    for number, size in enumerate(sizes):
        now += pauses[number % len(pauses)] if number % 7 == 0 else 0.0
        if not bucket.take(size, now):
            now += bucket.wait(size, now) + 1e-9
            assert bucket.take(size, now)
        left.append((now, size))
    for start, _ in left:
        window = sum(size for at, size in left if start <= at < start + 1.0)
        assert window <= rate + bucket.depth + 1.0


def test_a_second_holds_five_per_cent_more_at_most_from_40_kilobytes_up() -> None:
    assert Bucket(40e3, 0.0).depth <= 0.05 * 40e3
    assert Bucket(125e3, 0.0).depth <= 0.05 * 125e3


def test_a_datagram_larger_than_the_bucket_waits_for_a_full_one_and_is_paid_for() -> None:
    bucket = Bucket(1000.0, 0.0)
    assert bucket.take(3000, 0.0)
    assert not bucket.take(100, 1.0)
    assert bucket.wait(100, 1.0) == pytest.approx(0.6)
