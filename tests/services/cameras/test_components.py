"""What a camera's component knows of itself between two words of its program."""

from __future__ import annotations

import msgspec
import pytest

from zmav.services.cameras.components import Capturing

BEFORE = Capturing(width=640, taken=3, every=0.3, zoom=2.0, most_zoom=8.0)


def test_an_order_that_is_done_is_known_at_once() -> None:
    assert BEFORE.after("zoom", {"factor": 4.0}) == msgspec.structs.replace(BEFORE, zoom=4.0)
    assert BEFORE.after("photo", {"every": 0.5, "count": 0}) == msgspec.structs.replace(BEFORE, every=0.5)
    assert BEFORE.after("stop", {"taken": 3}) == msgspec.structs.replace(BEFORE, every=0.0)


def test_a_photo_ends_a_series_and_is_the_last_one() -> None:
    after = BEFORE.after("photo", {"number": 4, "t": 10.0, "file": "/p/4.jpg", "camera": "down", "position": None})
    assert after.photo is not None
    assert (after.taken, after.every, after.zoom, after.photo.file) == (4, 0.0, 2.0, "/p/4.jpg")
    assert BEFORE.after("photo", {"number": 2, "t": 9.0, "file": "/p/2.jpg"}).taken == 3, "a later one is known already"


@pytest.mark.parametrize(
    ("verb", "answer"),
    [("zoom", {"factor": "wide"}), ("zoom", {}), ("photo", {"number": 4}), ("photo", {}), ("stop", {"every": None})],
)
def test_an_answer_of_another_version_is_refused(verb: str, answer: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        BEFORE.after(verb, answer)
