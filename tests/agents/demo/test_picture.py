"""The picture of a demo, and the distances behind it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from agents.demo.picture import draw, draw_figure, without_rest
from agents.demo.play import Mark
from agents.demo.report import slow_words
from agents.demo.watch import Row, Truth
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


def stood(t: float, east: float = 0.0, up: float = 0.0) -> Row:
    return Row(t, ((0.0, east, up), (0.0, 30.0 - east, up)))


LINE = [
    *(stood(float(t)) for t in range(330)),
    *(stood(330.0 + t, 0.3 * t, min(5.0, 0.5 * t, 0.5 * (100 - t))) for t in range(101)),
    *(stood(431.0 + t, 30.0) for t in range(40)),
]
"""two that stand for 330 s, fly along a line for 100 s, and stand"""


def test_what_is_shown_begins_with_the_first_that_moves_and_ends_with_the_last() -> None:
    figure = draw_figure(["a", "b"], LINE, [Mark(2.0, "early"), Mark(340.0, "amid"), Mark(460.0, "late")], "a test")
    heights = figure.axes[1]
    assert heights.get_xlim() == (328.0, 432.0)
    marked = [np.asarray(line.get_xdata())[0] for line in heights.lines if line.get_linestyle() == ":"]
    assert marked == [340.0]
    assert list(without_rest(LINE[:9])) == LINE[:9], "nobody moves"


def test_a_way_along_a_line_is_seen_from_above() -> None:
    figure = draw_figure(["a", "b"], LINE, [], "a test")
    figure.draw_without_rendering()
    above = figure.axes[0]
    (west, east), (south, north) = above.get_xlim(), above.get_ylim()
    assert west < 0.0 < 30.0 < east
    assert north - south > 12.0 - 1e-9
    box = above.get_window_extent()
    assert box.height > 0.5 * figure.bbox.height
    assert (east - west) / box.width == pytest.approx((north - south) / box.height, rel=0.02), "one scale"


def test_no_word_lies_on_another() -> None:
    figure = draw_figure([f"quad{k}" for k in range(2)], LINE, [], "a test")
    figure.draw_without_rendering()
    legend = figure.axes[0].get_legend()
    assert legend is not None
    texts = [*figure.texts, *legend.get_texts()]
    texts += [text for axes in figure.axes for text in (*axes.texts, axes.title, axes.xaxis.label, axes.yaxis.label)]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text()]
    assert len(boxes) >= 7, "two names and five labels"
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        assert not a.overlaps(b), (one, other)
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for _, box in boxes)


def test_truth_knows_how_far_how_high_and_how_near() -> None:
    truth = Truth(["a", "b"])
    for row in ROWS:
        truth.take(row.places)
    assert truth.flown("a") == pytest.approx(5.9)
    assert truth.highest("b") == 5.0
    nearest = min(((0.1 * k) ** 2 + (8.0 - 0.1 * k) ** 2) ** 0.5 for k in range(60))
    assert truth.closest == pytest.approx(nearest)
    assert truth.pair == ("a", "b")


def test_a_simulation_that_was_too_slow_is_told() -> None:
    assert slow_words(Truth(["a"]).pace) == slow_words(0.97) == "", "nothing was seen; or next to nothing"
    assert "0.62 times as fast as asked for" in slow_words(0.62)
