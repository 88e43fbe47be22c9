"""Reading recordings: all of a sound one, all that is sound of a damaged one, and never an exception."""

from __future__ import annotations

import io
import random
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.links import tlog
from zmav.links.tlog import CHUNK, TlogReader

START_US = 1_790_000_000_000_000


def frame(version: int, payload: bytes, signed: bool = False) -> bytes:
    if version == 1:
        return bytes([0xFE, len(payload), 7, 1, 1, 30]) + payload + b"\xab\xcd"
    header = bytes([0xFD, len(payload), 1 if signed else 0, 0, 7, 1, 1, 30, 0, 0])
    return header + payload + b"\xab\xcd" + (b"\x5a" * 13 if signed else b"")


def record(stamp: int, data: bytes) -> bytes:
    return stamp.to_bytes(8, "big") + data


RECORDS = st.lists(
    st.tuples(
        st.integers(0, 10**9),
        st.tuples(st.sampled_from([1, 2]), st.binary(max_size=255), st.booleans()).map(lambda parts: frame(*parts)),
    ),
    max_size=30,
).map(lambda found: [(START_US + offset, data) for offset, data in found])


def read(data: bytes, chunk: int = CHUNK) -> tuple[list[tuple[int, bytes]], TlogReader]:
    reader = TlogReader(io.BytesIO(data), chunk=chunk)
    return list(reader), reader


@given(RECORDS)
def test_sound_recording_is_read_whole(records: list[tuple[int, bytes]]) -> None:
    found, reader = read(b"".join(record(*one) for one in records))
    assert found == records
    assert (reader.records, reader.skipped, reader.trouble) == (len(records), 0, None)


@given(RECORDS.filter(bool), st.data())
def test_torn_end_is_dropped_and_told(records: list[tuple[int, bytes]], data: st.DataObject) -> None:
    whole = b"".join(record(*one) for one in records)
    last = len(record(*records[-1]))
    kept = data.draw(st.integers(1, last - 1))
    found, reader = read(whole[: len(whole) - last + kept])
    assert found[: len(records) - 1] == records[:-1]
    if len(found) < len(records):  # (random payloads may hold something that looks like a record)
        assert reader.skipped == kept
        assert reader.trouble is not None


def test_torn_end_words() -> None:
    one = record(START_US, frame(2, bytes(20)))
    _, reader = read(one + one[:15])
    assert reader.trouble == f"ends in the middle of a record: 15 bytes at offset {len(one)} dropped"
    assert reader.skipped == 15


def series(count: int) -> list[tuple[int, bytes]]:
    return [(START_US + 1000 * n, frame(1 + n % 2, n.to_bytes(4, "big") * (n % 9), n % 4 == 1)) for n in range(count)]


@pytest.mark.parametrize("junk", [b"\x00" * 700, b"\xfd" * 33, b"some text\n" * 50, bytes(range(256)) * 3])
def test_junk_between_records_costs_no_record(junk: bytes) -> None:
    records = series(20)
    pieces = [record(*one) for one in records]
    found, reader = read(junk + b"".join(pieces[:10]) + junk + b"".join(pieces[10:]) + junk)
    assert found == records
    assert reader.skipped == 3 * len(junk)


def test_one_spoiled_byte_costs_at_most_the_record_it_is_in() -> None:
    records = series(12)
    pieces = [record(*one) for one in records]
    sound = b"".join(pieces)
    start = len(b"".join(pieces[:6]))
    for at in range(start, start + len(pieces[6])):
        for spoil in (0x01, 0x80, 0xFF):
            data = bytearray(sound)
            data[at] ^= spoil
            found, _ = read(bytes(data))
            others = records[:6] + records[7:]
            assert [one for one in found if one in others] == others, f"byte {at - start} spoiled by {spoil:#x}"


def test_damage_across_buffers() -> None:
    """The same recording and damage, read in pieces of any size: the same records."""
    records = series(400)
    rng = random.Random(1)
    data = bytearray()
    for one in records:
        data += record(*one)
        if rng.random() < 0.05:
            data += rng.choice([bytes(rng.randrange(1, 3000)), b"\xfe\xfd" * rng.randrange(1, 300)])
    expected, whole = read(bytes(data))
    assert expected == records
    for chunk in (1, 100, tlog.AHEAD, tlog.AHEAD + 1, 1777, 5000):
        found, reader = read(bytes(data), chunk)
        assert found == expected
        assert reader.skipped == whole.skipped


def test_a_reader_lost_in_junk_can_be_stopped() -> None:
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > 3

    file = io.BytesIO(b"\x00" * 8_000_000)
    assert list(TlogReader(file, stop)) == []
    assert file.tell() < 4_000_000


@pytest.mark.parametrize("name", ["copter", "copter_params", "plane", "rover", "px4", "px4_three"])
def test_real_recordings(shared_data: Path, name: str) -> None:
    data = (shared_data / f"{name}.tlog").read_bytes()
    found, reader = read(data)
    assert b"".join(record(*one) for one in found) == data
    assert reader.skipped == 0
    assert reader.records == len(found) > 1000
