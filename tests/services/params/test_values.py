"""zmav/services/params/values.py: read while it grows, for answers are worked out beside the event loop."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.params.values import Entry, ParamSet, ParamValue

MANY = 400


def heard(index: int, count: int) -> ParamValue:
    return ParamValue(f"P{index}", Entry(bytes(4), "REAL32"), count, index)


@pytest.fixture
def growing() -> Iterator[ParamSet]:
    """A set that hears of another parameter at each collection of garbage, which is wherever something is allocated."""
    known, number = ParamSet(), iter(range(1, MANY))
    known.hear(heard(0, MANY))

    def grow(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and (index := next(number, None)) is not None:
            known.hear(heard(index, MANY))

    before = gc.get_threshold()
    gc.callbacks.append(grow)
    gc.set_threshold(1)
    yield known
    gc.set_threshold(*before)
    gc.callbacks.remove(grow)


def test_a_set_that_grows_meanwhile_is_told_as_it_was(growing: ParamSet) -> None:
    for _ in range(20):
        table = growing.table(ParamEncoding.C_CAST, "ardupilot", None)
        assert [param.name for param in table.params] == [f"P{n}" for n in range(len(table.params))]
        assert growing.names()
