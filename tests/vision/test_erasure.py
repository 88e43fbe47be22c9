"""Spare chunks of video: any of them mend as many lost ones, and as many are made as a link needs."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zmav.vision.assembler import Assembler
from zmav.vision.chunks import MOST_CHUNK, VIDEO, split
from zmav.vision.erasure import GROUP, MOST, TORN, encode, mend, needed


@settings(deadline=None)
@given(count=st.integers(1, 60), spare=st.integers(0, 20), seed=st.integers(0, 10_000))
def test_any_so_many_chunks_are_enough(count: int, spare: int, seed: int) -> None:
    rng = random.Random(seed)
    chunks = [rng.randbytes(16) for _ in range(count - 1)] + [rng.randbytes(rng.randint(1, 16))]
    spares = encode(chunks, 16, spare)
    came = rng.sample(range(count + spare), count)
    data = {i: chunks[i] for i in came if i < count}
    more = {i - count: spares[i - count] for i in came if i >= count}
    assert mend(count, 16, data, more) == [each.ljust(16, b"\0") for each in chunks]
    if data:
        data.pop(next(iter(data)))
        assert mend(count, 16, data, more) is None, "one less is too little"


def test_large_units_are_mended_group_by_group() -> None:
    rng = random.Random(3)
    chunks = [rng.randbytes(8) for _ in range(3 * GROUP + 5)]
    spares = dict(enumerate(encode(chunks, 8, 40)))
    lost = rng.sample(range(len(chunks)), 25)
    kept = {i: chunk for i, chunk in enumerate(chunks) if i not in lost}
    assert mend(len(chunks), 8, kept, spares) == chunks
    in_one_group = range(0, 44, 4)
    kept = {i: chunk for i, chunk in enumerate(chunks) if i not in in_one_group}
    assert mend(len(chunks), 8, kept, spares) is None, "11 lost of one group, which has 10 spare ones"


@pytest.mark.parametrize(("count", "percent"), [(1, 5), (4, 5), (4, 20), (30, 5), (30, 30), (250, 10)])
def test_as_many_are_made_as_the_loss_asks_for(count: int, percent: int) -> None:
    rng, spare = random.Random(1), needed(count, percent)
    groups = -(-count // GROUP)
    size = -(-count // groups)

    def tears() -> bool:
        sent, most = size + spare // groups, spare // groups
        return any(sum(rng.random() < percent / 100 for _ in range(sent)) > most for _ in range(groups))

    torn = sum(tears() for _ in range(4000))
    assert torn <= 4000 * TORN + 3 * (4000 * TORN) ** 0.5
    assert spare <= max(count, 6), "no more than the unit itself, but for the smallest"
    assert needed(940, 60) <= MOST


def test_a_unit_in_chunks_comes_together_without_some_of_them() -> None:
    unit = random.Random(5).randbytes(30_000)
    parts = split(unit, sender=7, seq=1, t=5.0, size=(1280, 720), spare=6, code=VIDEO)
    assert max(map(len, parts)) <= MOST_CHUNK
    assembler = Assembler(VIDEO)
    (whole,) = [found for part in parts[3:31] + parts[32:] if (found := assembler.add(part, 0.0)) is not None]
    assert whole.jpeg == unit
    picture = split(unit, sender=7, seq=1, t=5.0, size=(1280, 720))
    assert Assembler(VIDEO).add(picture[0], 0.0) is None, "a picture's chunk is none of video"
