"""Chunks of pictures: what is split comes together again, whatever is lost within reason and whatever is sent."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zmav.errors import BadInput, BadMessage
from zmav.vision import parity
from zmav.vision.assembler import GIVE_UP, UNDER_WAY, Assembler, Whole
from zmav.vision.chunks import HEADER, MOST_CHUNK, MOST_JPEG, ROOM, count_of, parse, split

SIZE = (640, 480)
pictures = st.integers(1, 12_000).map(lambda n: random.Random(n).randbytes(n))


def chunks(jpeg: bytes, seq: int = 0, spare: int = 0, sender: int = 7, t: float = 5.0) -> list[bytes]:
    return split(jpeg, sender=sender, seq=seq, t=t, size=SIZE, spare=spare)


def feed(assembler: Assembler, parts: list[bytes], now: float = 0.0) -> list[Whole]:
    return [whole for part in parts if (whole := assembler.add(part, now)) is not None]


@given(jpeg=pictures, spare=st.integers(0, 20), order=st.randoms(use_true_random=False))
def test_a_picture_comes_together_in_any_order(jpeg: bytes, spare: int, order: random.Random) -> None:
    parts = chunks(jpeg, seq=3, spare=spare)
    assert len(parts) == count_of(len(jpeg)) + spare
    assert max(map(len, parts)) <= MOST_CHUNK
    order.shuffle(parts)
    assembler = Assembler()
    (whole,) = feed(assembler, parts)
    assert (whole.jpeg, whole.seq, whole.t, whole.width, whole.height) == (jpeg, 3, 5.0, *SIZE)
    assert (assembler.whole, assembler.torn, assembler.bad, assembler.again) == (1, 0, 0, 0)
    assert assembler.bytes == sum(map(len, parts))


@given(jpeg=pictures, lost=st.integers(0, 100))
def test_one_parity_chunk_mends_any_one_lost(jpeg: bytes, lost: int) -> None:
    parts = chunks(jpeg, spare=1)
    del parts[lost % len(parts)]
    (whole,) = feed(Assembler(), parts)
    assert whole.jpeg == jpeg


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_so_much_parity_as_is_said_to_be_needed_mends_nearly_all(loss: float) -> None:
    rng = random.Random(1)
    jpeg = rng.randbytes(30 * ROOM)
    parts = chunks(jpeg, spare=parity.needed(30, loss))
    came = 0
    for _ in range(200):
        came += len(feed(Assembler(), [part for part in parts if rng.random() >= loss]))
    assert came >= 0.97 * 200
    assert len(parts) < 30 * (1 + 4.5 * loss)  # at 10 %: less than half as many again, at 30 %: about twice


def test_much_loss_asks_for_much_parity_and_none_for_little() -> None:
    counts = [parity.needed(30, loss) for loss in (0.0, 0.01, 0.1, 0.3, 0.6)]
    assert counts == sorted(counts)
    assert counts[0] == 1
    assert parity.needed(30, 1.0) == parity.MOST


@settings(max_examples=50)
@given(data=st.binary(max_size=1200), flips=st.lists(st.tuples(st.integers(0, 1099), st.integers(0, 255)), max_size=4))
def test_nothing_that_comes_raises(data: bytes, flips: list[tuple[int, int]]) -> None:
    jpeg = bytes(range(256)) * 16
    parts = chunks(jpeg, spare=2)
    assembler = Assembler()
    found = feed(assembler, [data])
    for part in parts:
        spoiled = bytearray(part)
        for at, value in flips:
            if at < len(spoiled):
                spoiled[at] ^= value
        found += feed(assembler, [bytes(spoiled), part, part[:-1], b""])
    assert all(whole.jpeg == jpeg for whole in found)  # the CRC lets no spoiled one pass
    assert len(assembler) <= UNDER_WAY
    assert assembler.bad > 0


HOSTILE = {
    "magic": (0, b"XX"),
    "version": (2, b"\x02"),
    "index": (12, b"\xff\xff"),
    "no chunks": (14, b"\x00\x00"),
    "length": (16, struct.pack(">I", MOST_JPEG + 1)),
    "no width": (24, b"\x00\x00"),
    "no time": (28, struct.pack(">d", float("nan"))),
    "far future": (28, struct.pack(">d", 1e12)),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_chunk_that_cannot_be_is_refused(what: str) -> None:
    at, value = HOSTILE[what]
    chunk = bytearray(chunks(b"x" * 3000)[0])
    chunk[at : at + len(value)] = value
    with pytest.raises(BadMessage):
        parse(bytes(chunk))


@pytest.mark.parametrize("length", [0, MOST_JPEG + 1])
def test_a_picture_of_no_or_too_many_bytes_is_not_sent(length: int) -> None:
    with pytest.raises(BadInput, match="bytes cannot be sent"):
        chunks(bytes(length))


def test_the_largest_picture() -> None:
    jpeg = random.Random(0).randbytes(MOST_JPEG)
    (whole,) = feed(Assembler(), chunks(jpeg, spare=2)[1:])
    assert whole.jpeg == jpeg


def test_newest_wins_and_what_is_missed_is_counted() -> None:
    old, torn, new = (chunks(bytes([n]) * 3000, seq=n) for n in (1, 2, 5))
    assembler = Assembler()
    assert [w.seq for w in feed(assembler, [*old, *torn[:-1], *new, torn[-1]])] == [1, 5]
    assert (assembler.whole, assembler.torn) == (2, 3)  # 2, and 3 and 4 of which nothing came
    assert feed(assembler, old) == []


def test_duplicates_are_counted_and_change_nothing() -> None:
    parts = chunks(b"y" * 5000)
    assembler = Assembler()
    assert len(feed(assembler, [parts[0], parts[0], *parts[1:]])) == 1
    assert assembler.again == 1


def test_no_more_than_a_few_pictures_are_held() -> None:
    assembler = Assembler()
    for seq in range(100):
        feed(assembler, chunks(bytes(5000), seq=seq)[:-1])
    assert len(assembler) == UNDER_WAY
    assert assembler.torn == 100 - UNDER_WAY
    assembler.expire(GIVE_UP + 0.1)
    assert (assembler.torn, len(assembler)) == (100, 0)


def test_a_restarted_sender_is_heard_once_the_old_one_is_silent() -> None:
    assembler = Assembler()
    assert feed(assembler, chunks(b"a" * 3000, seq=900, sender=1), now=0.0)
    other = chunks(b"b" * 3000, seq=0, sender=2)
    assert not feed(assembler, other, now=0.5)
    assert assembler.foreign == len(other)
    assert [w.seq for w in feed(assembler, other, now=0.5 + GIVE_UP)] == [0]
    assert assembler.torn == 0


def test_the_sequence_may_begin_again() -> None:
    assembler = Assembler()
    for seq in (2**32 - 1, 0, 1):
        assert [w.seq for w in feed(assembler, chunks(b"z" * 100, seq=seq))] == [seq]
    assert (assembler.whole, assembler.torn) == (3, 0)


def test_a_gap_is_counted_within_reason() -> None:
    assembler = Assembler()
    feed(assembler, chunks(b"z", seq=0))
    feed(assembler, chunks(b"z", seq=2**31 - 1))
    assert assembler.torn == 1000


def test_the_header_is_as_documented() -> None:
    (chunk,) = chunks(b"jpeg", seq=9, sender=8, t=2.5)
    assert HEADER.size == 36
    assert chunk[:16] == b"zJ\x01\x00" + struct.pack(">II", 8, 9) + struct.pack(">HH", 0, 1)
    assert chunk[16:20] == struct.pack(">I", 4)
    assert chunk[24:36] == struct.pack(">HHd", 640, 480, 2.5)
    assert chunk[36:] == b"jpeg"
