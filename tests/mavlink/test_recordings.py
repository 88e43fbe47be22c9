"""Recorded flights: every frame comes through unchanged, and reads as pymavlink reads it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from zmav.mavlink import Dialect, Frame, Splitter, decode, describe

Recording = Callable[[str], list[bytes]]
RECORDINGS = ["copter.tlog", "copter_params.tlog", "plane.tlog", "rover.tlog", "px4.tlog", "px4_three.tlog"]
PX4S_OWN = {8, 380, 410, 411, 436}
"""which pymavlink's dialect lacks"""


def losses(frames: list[bytes]) -> int:
    """How many sequence numbers no frame of their sender has, whatever the order, counted from the bytes alone."""
    counts: dict[bytes, list[int]] = {}
    for data in frames:
        numbers = counts.setdefault(data[5:7], [data[4]])
        step = (data[4] - numbers[-1] + 128) % 256 - 128
        numbers.append(numbers[-1] + step)
    return sum(max(numbers) - min(numbers) + 1 - len(set(numbers)) for numbers in counts.values())


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.parametrize("chunk", [0, 512])
def test_every_frame_comes_through(recording: Recording, dialect: Dialect, name: str, chunk: int) -> None:
    sent = recording(name)
    stream = b"".join(sent)
    parts = [stream[k : k + chunk] for k in range(0, len(stream), chunk)] if chunk else sent
    splitter = Splitter(dialect)
    frames = [frame for part in parts for frame in splitter.feed(part)]
    assert [frame.data for frame in frames] == sent
    counters = splitter.counters
    assert (counters.frames, counters.bytes) == (len(sent), len(stream))
    assert (counters.garbage, counters.bad_crc, counters.bad_length, counters.bad_flags) == (0, 0, 0, 0)
    assert counters.lost == losses(sent)
    assert counters.unknown == 0
    assert sum(source.frames for source in splitter.sources.values()) == len(sent)


@pytest.mark.parametrize("name", RECORDINGS)
def test_fields_are_those_pymavlink_reads(recording: Recording, dialect: Dialect, pymav: ModuleType, name: str) -> None:
    judge = pymav.MAVLink(None)
    splitter = Splitter(dialect)
    seen = 0
    for data in recording(name):
        (frame,) = splitter.feed(data)
        theirs = judge.parse_char(data)
        if frame.msgid in PX4S_OWN:
            assert theirs.get_type() == f"UNKNOWN_{frame.msgid}"
            continue
        header = theirs.get_header()
        assert (frame.sysid, frame.compid, frame.seq) == (header.srcSystem, header.srcComponent, header.seq)
        assert dialect.name_of(frame.msgid) == theirs.get_type()
        ours = decode(frame, dialect)
        assert repr(ours) == repr({field: getattr(theirs, field) for field in theirs.get_fieldnames()})
        seen += 1
    assert seen > 1000


def test_px4s_own_messages_are_checked_and_read(recording: Recording, dialect: Dialect) -> None:
    """Their checksums say that the definitions are PX4's."""
    found: dict[str, list[Frame]] = defaultdict(list)
    splitter = Splitter(dialect)
    for data in recording("px4.tlog"):
        for frame in splitter.feed(data):
            if frame.msgid in PX4S_OWN:
                assert frame.verified
                found[dialect.name_of(frame.msgid)].append(frame)
    assert sum(map(len, found.values())) == 160
    modes = {decode(frame, dialect)["custom_mode"] for frame in found["CURRENT_MODE"]}
    assert {3 << 24 | 4 << 16, 6 << 16, 6 << 24 | 4 << 16} <= modes  # HOLD, OFFBOARD, LAND
    shown = describe(found["EVENT"][0], dialect)
    assert shown.name == "EVENT" and int(str(shown.fields["id"])) >> 24 == 1


def test_without_some_messages_a_recording_has_losses(recording: Recording, dialect: Dialect) -> None:
    """The counting really sees them: leave them out, and they are missed."""
    sent = recording("px4.tlog")
    kept = [data for data in sent if int.from_bytes(data[7:10], "little") not in PX4S_OWN]
    splitter = Splitter(dialect)
    for data in kept:
        splitter.feed(data)
    assert splitter.counters.lost == losses(sent) + len(sent) - len(kept)


@pytest.mark.parametrize("name", ["copter.tlog", "px4.tlog"])
def test_a_recording_with_damage_loses_no_more_than_the_damaged(
    recording: Recording, dialect: Dialect, name: str
) -> None:
    sent = recording(name)[:2000]
    damaged: list[Any] = list(sent)
    for index in range(7, len(sent), 50):
        data = sent[index]
        damaged[index] = data[:11] + bytes([data[11] ^ 0x10]) + data[12:]
    splitter = Splitter(dialect)
    stream = b"".join(damaged)
    found = {frame.data for k in range(0, len(stream), 100) for frame in splitter.feed(stream[k : k + 100])}
    missing = [k for k, data in enumerate(sent) if data not in found]
    spoilt = set(range(7, len(sent), 50))
    for index in missing:
        assert index in spoilt
    assert splitter.counters.bad_crc >= len(spoilt) - 1
