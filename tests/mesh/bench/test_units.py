"""Rates as people write them, and what a datagram holds."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesh.bench import run
from mesh.units import duration, milliseconds, percent, rate, size
from zmav.config.mesh import bits_per_second
from zmav.errors import BadInput


@pytest.mark.parametrize(
    ("text", "bits"),
    [("1Mbit/s", 1e6), ("60 kB/s", 480e3), ("500k", 500e3), ("0.5 Mbit/s", 5e5), ("9600", 9600.0), ("2Gbit/s", 2e9)],
)
def test_rates(text: str, bits: float) -> None:
    assert bits_per_second(text) == bits


@pytest.mark.parametrize("text", ["", "fast", "-1k", "0", "1 MB", "nan", "inf", "1e9", "1Mbit", "1..5k"])
def test_what_is_no_rate_is_said(text: str) -> None:
    with pytest.raises(BadInput) as caught:
        bits_per_second(text)
    assert caught.value.detail["field"] == "rate"


def test_how_they_are_printed() -> None:
    assert (rate(1.5e6), rate(12_000), rate(3)) == ("1.50 Mbit/s", "12.00 kbit/s", "3 bit/s")
    assert (size(2.5e6), size(12)) == ("2.50 MB", "12 B")
    assert (duration(2), duration(0.0015), duration(-0.00002)) == ("2.00 s", "1.50 ms", "-20.00 µs")


def test_figures_of_links() -> None:
    assert [milliseconds(s) for s in (None, 0.00012, 0.0123, 1.5)] == ["-", "0.12", "12.3", "1500"]
    assert [percent(s) for s in (None, 0.0, 0.0123, 0.5)] == ["-", "0%", "1.2%", "50%"]
    assert [rate(s) for s in (None, 80.0, 60e3)] == ["-", "80 bit/s", "60.00 kbit/s"]
    assert [duration(s) for s in (None, 0.0, 120.4)] == ["-", "0 s", "120.40 s"]


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(max_size=100))
def test_a_datagram_says_its_number_and_time_to_its_own_run_only(number: int, sent: int, filling: bytes) -> None:
    tag = run.tag_of("one")
    data = run.HEAD.pack(tag, number, sent) + filling
    assert run.read_datagram(data, tag) == (number, sent)
    assert run.read_datagram(data, run.tag_of("another")) is None
    assert run.read_datagram(data[: run.LEAST - 1], tag) is None


@settings(max_examples=40)
@given(st.binary(max_size=64))
def test_garbage_is_no_datagram(data: bytes) -> None:
    tag = run.tag_of("one")
    assert run.read_datagram(data, tag) is None or data[:4] == tag.to_bytes(4, "little")
