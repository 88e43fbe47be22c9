"""What is missing of a file, against a set of its bytes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from zmav.services.files.sink import Gaps

RANGES = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20)), max_size=30)


@given(RANGES)
def test_the_gaps_are_the_bytes_that_did_not_come(came: list[tuple[int, int]]) -> None:
    gaps, missing = Gaps([(0, 50)]), set(range(50))
    for start, length in came:
        new = set(range(start, start + length)) & missing
        assert gaps.fill(start, start + length) == len(new)
        missing -= new
        assert {i for a, b in gaps for i in range(a, b)} == missing
        assert gaps.total == len(missing)
        assert bool(gaps) == bool(missing)
        ends = [end for pair in gaps for end in pair]
        assert ends == sorted(set(ends)), "sorted, apart, and none empty"
        if missing:
            assert next(iter(gaps))[0] == min(missing)


def test_an_end_that_becomes_known() -> None:
    gaps = Gaps([(0, 100)])
    gaps.fill(10, 20)
    gaps.cut(30)
    assert list(gaps) == [(0, 10), (20, 30)]
    assert gaps.merged(11) == [(0, 30)]
    assert gaps.merged(10) == [(0, 10), (20, 30)]
    gaps.cut(5)
    assert list(gaps) == [(0, 5)]
