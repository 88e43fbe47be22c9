"""Figures and texts for a terminal."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from ground.top.columns import fit, milliseconds, number, percent
from zmav.doctor.words import clean, duration


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (None, "-"),
        (-1.0, "0.0s"),
        (0.44, "0.4s"),
        (9.94, "9.9s"),
        (9.96, "10s"),
        (99.4, "99s"),
        (100.0, "1m40"),
        (3599.0, "59m59"),
        (3600.0, "1h00"),
        (86399.0, "23h59"),
        (86400.0, "1d"),
        (1e12, "9999d"),
    ],
)
def test_durations_fit_their_column(seconds: float | None, words: str) -> None:
    assert duration(seconds) == words
    assert len(words) <= 5


def test_figures() -> None:
    assert [percent(share) for share in (None, 0.0, 0.001, 0.3, 1.0)] == ["-", "0%", "<1%", "30%", "100%"]
    assert [number(value) for value in (None, -0.04, 3.14159)] == ["-", "0.0", "3.1"]
    assert [milliseconds(s) for s in (None, 0.00123, 0.0099, 0.2)] == ["-", "1.2", "9.9", "200"]


@given(st.text(max_size=60), st.integers(0, 40), st.booleans())
def test_any_text_is_fitted_exactly_and_moves_no_cursor(text: str, width: int, right: bool) -> None:
    found = fit(text, width, right=right)
    assert cell_len(found) == width
    assert clean(found) == found
    assert not any(ord(c) < 32 or 0x7F <= ord(c) < 0xA0 for c in found)


@pytest.mark.parametrize(
    "evil", ["\x1b]0;title\x07", "\x9b2J", "a\u202eb", "a\u200bb", "x\u0301\u0302\u0303", "\ud800", "a\x00b"]
)
def test_what_a_terminal_would_obey_is_taken_out(evil: str) -> None:
    found = clean(evil)
    assert found.isprintable()
    assert found.isascii()


def test_a_cut_text_says_so() -> None:
    assert fit("autopilot silent", 8) == "autopil~"
    assert fit("autopilot", 9) == "autopilot"
    assert fit("四旋翼", 5) == "四旋~"
