"""The picture of a demo and its animation, and the distances behind them."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.demo.picture import animate, draw
from agents.demo.play import Mark
from agents.demo.truth import Row, Truth
from zmav.errors import BadInput

ROWS = [Row(0.2 * k, ((0.1 * k, 0.0, 5.0), (0.0, 8.0 - 0.1 * k, 5.0))) for k in range(60)]


def test_tracks_are_drawn_or_it_is_said_why_not(tmp_path: Path) -> None:
    marks = [Mark(1.0, "ready"), Mark(5.0, "cut: a - b")]
    draw(["a", "b"], ROWS, marks, "a test", tmp_path / "tracks.svg")
    drawn = (tmp_path / "tracks.svg").read_text()
    assert "<svg" in drawn
    with pytest.raises(BadInput, match=r"cannot draw .*\.xyz"):
        draw(["a", "b"], ROWS, marks, "a test", tmp_path / "tracks.xyz")
    with pytest.raises(BadInput, match=r"cannot write .*nowhere"):
        draw(["a", "b"], ROWS, marks, "a test", tmp_path / "nowhere" / "tracks.png")


def test_an_animation_is_a_gif_or_it_is_said_why_not(tmp_path: Path) -> None:
    animate(["a", "b"], ROWS[:20], "a test", tmp_path / "tracks.gif", frames=3)
    assert (tmp_path / "tracks.gif").read_bytes().startswith(b"GIF8")
    with pytest.raises(BadInput, match=r"cannot draw .*nowhere"):
        animate(["a", "b"], ROWS[:20], "a test", tmp_path / "nowhere" / "tracks.gif", frames=3)


def test_truth_knows_how_far_how_high_and_how_near() -> None:
    truth = Truth(["a", "b"])
    for row in ROWS:
        truth.take(row.places)
    assert truth.flown("a") == pytest.approx(5.9)
    assert truth.highest("b") == 5.0
    nearest = min(((0.1 * k) ** 2 + (8.0 - 0.1 * k) ** 2) ** 0.5 for k in range(60))
    assert truth.closest == pytest.approx(nearest)
    assert truth.pair == ("a", "b")
