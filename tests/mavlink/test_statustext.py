"""Texts in pieces: whole again whatever happened on the way, and said with a gap where that cannot be."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.mavlink import Frame, load_dialect, parse_frame
from zmav.mavlink.frame import build_frame
from zmav.mavlink.statustext import MEMORY, MOST, WAIT, TextJoiner

DIALECT = load_dialect()
LONG = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=51, max_size=180)


def pieces(text: str, number: int, compid: int = 1, severity: int = 4) -> list[Frame]:
    """A text as ArduPilot sends it: an empty piece follows one that ends with its last piece."""
    raw = text.encode()
    chunks = [raw[i : i + 50] for i in range(0, len(raw) + 1, 50)]
    return [piece(chunk, number, seq, compid, severity) for seq, chunk in enumerate(chunks)]


def piece(chunk: bytes, number: int, seq: int, compid: int = 1, severity: int = 4) -> Frame:
    """By hand: a piece may hold half a character, which no string can."""
    payload = bytes((severity,)) + chunk.ljust(50, b"\0") + number.to_bytes(2, "little") + bytes((seq,))
    return parse_frame(build_frame(DIALECT.message("STATUSTEXT"), payload, 1, compid, 0), DIALECT)


def said(joiner: TextJoiner, frames: list[Frame], now: float = 0.0) -> list[str]:
    return [text.text for frame in frames for text in joiner.add(frame, now)]


def test_a_text_of_one_piece_is_said_at_once() -> None:
    joiner = TextJoiner()
    (text,) = joiner.add(piece(b"PreArm: no GPS", 0, 0, compid=7, severity=2), 5.0)
    assert text == (7, 2, "PreArm: no GPS", True, 5.0)
    (text,) = joiner.add(piece(b"x" * 50, 0, 0), 5.0)
    assert text.text == "x" * 50
    assert joiner.unfinished() == []


@given(
    texts=st.lists(LONG, min_size=1, max_size=5),
    seed=st.randoms(use_true_random=False),
)
def test_whole_again_however_mixed_doubled_and_turned_round(texts: list[str], seed: random.Random) -> None:
    frames = [frame for number, text in enumerate(texts, 1) for frame in pieces(text, number)]
    frames += seed.sample(frames, len(frames) // 2)
    seed.shuffle(frames)
    joiner = TextJoiner()
    assert sorted(said(joiner, frames)) == sorted(text.encode().decode("utf-8", "replace") for text in texts)
    assert joiner.unfinished() == []
    assert joiner.flush(MEMORY) == []


def test_pieces_that_do_not_come_leave_a_mark() -> None:
    long = "a" * 50 + "b" * 50 + "c" * 50 + "d"
    for lost, words in (
        ({1}, "a" * 50 + "[...]" + "c" * 50 + "d"),
        ({1, 2}, "a" * 50 + "[...]" + "d"),
        ({0}, "[...]" + "b" * 50 + "c" * 50 + "d"),
        ({3}, "a" * 50 + "b" * 50 + "c" * 50 + "[...]"),
    ):
        joiner = TextJoiner()
        assert said(joiner, [f for seq, f in enumerate(pieces(long, 9)) if seq not in lost]) == []
        assert [text.text for text in joiner.unfinished()] == [words]
        assert joiner.flush(WAIT - 0.01) == []
        (text,) = joiner.flush(WAIT)
        assert (text.text, text.complete) == (words, False)
        assert joiner.flush(10.0) == []


def test_a_piece_that_comes_late_keeps_its_text_waiting() -> None:
    joiner = TextJoiner()
    first, second = pieces("x" * 60, 3)
    assert joiner.add(first, 0.0) == []
    joiner.add(first, 0.9)
    assert joiner.flush(1.5) == []
    (text,) = joiner.add(second, 1.8)
    assert (text.text, text.at) == ("x" * 60, 0.0)


def test_texts_of_different_senders_are_kept_apart() -> None:
    joiner = TextJoiner()
    mine, theirs = pieces("m" * 60, 1, compid=1), pieces("t" * 60, 1, compid=2)
    assert said(joiner, [mine[0], theirs[0], theirs[1], mine[1]]) == ["t" * 60, "m" * 60]


def test_an_id_is_used_again_for_another_text_but_a_copy_is_known() -> None:
    joiner = TextJoiner()
    first = pieces("x" * 60, 1)
    assert said(joiner, [*first, *first]) == ["x" * 60]
    assert said(joiner, pieces("y" * 60, 1), now=1.0) == ["y" * 60]
    assert said(joiner, pieces("y" * 60, 1), now=1.0 + MEMORY) == ["y" * 60]


def test_many_unfinished_texts_do_not_pile_up() -> None:
    joiner = TextJoiner()
    early = [text for n in range(1, MOST + 11) for text in joiner.add(pieces(f"{n:060}", n)[0], n / 1000)]
    assert [text.text for text in early] == [f"{n:060}"[:50] + "[...]" for n in range(1, 11)]
    assert len(joiner.unfinished()) == MOST


@pytest.mark.parametrize("payload", [b"", b"\x04", b"\x04abc", bytes(range(1, 60))])
def test_any_length_is_taken(payload: bytes) -> None:
    data = bytes((0xFD, len(payload), 0, 0, 0, 1, 1, 253, 0, 0)) + payload + b"\0\0"
    joiner = TextJoiner()
    joiner.add(Frame(data, 253, True), 0.0)
    assert len(joiner.flush(9.0)) <= 1
