"""EVENT: read from real frames, and nothing else taken for one."""

from __future__ import annotations

import struct
from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from zmav.mavlink import Frame, load_dialect, parse_frame
from zmav.mavlink.checksum import checksum
from zmav.mavlink.event import Event, read_event


def frame(payload: bytes) -> Frame:
    payload = payload.rstrip(b"\0") or payload[:1]
    body = bytes((len(payload), 0, 0, 7, 1, 1)) + (410).to_bytes(3, "little") + payload
    return parse_frame(
        b"\xfd" + body + checksum(body, load_dialect().message("EVENT").crc_extra).to_bytes(2, "little"), load_dialect()
    )


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**16 - 1),
    st.integers(0, 255),
    st.binary(max_size=40),
)
def test_what_was_sent_is_read(number: int, boot: int, sequence: int, levels: int, arguments: bytes) -> None:
    payload = struct.pack("<IIHBBB40s", number, boot, sequence, 190, 255, levels, arguments)
    event = read_event(frame(payload))
    assert event == Event(number, boot, sequence, levels & 15, levels >> 4, arguments.ljust(40, b"\0"))
    assert f"0x{number:08x}" in str(event)
    assert event.for_people == (levels & 15 < 8)


def test_what_is_no_event_is_left_alone() -> None:
    heartbeat = bytes.fromhex("fd0900000001010000000000000002030004039f5b")
    assert read_event(Frame(heartbeat, 0, True)) is None
    assert read_event(Frame(b"\xfe" + bytes(20), 410, False)) is None


def test_every_event_of_the_recordings_checks_and_counts_up(recording: Callable[[str], list[bytes]]) -> None:
    for name, least in (("px4.tlog", 15), ("px4_three.tlog", 20)):
        frames = [parse_frame(data, load_dialect()) for data in recording(name) if data[7:10] == b"\x9a\x01\x00"]
        events = [(f.sysid, read_event(f)) for f in frames]
        assert len(events) >= least
        for sysid in {s for s, _ in events}:
            own = [e for s, e in events if s == sysid]
            assert all(e is not None and e.level <= 8 for e in own)
            sequences = [e.sequence for e in own if e is not None]
            assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
