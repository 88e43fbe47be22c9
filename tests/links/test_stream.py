"""The outbox of byte streams: whatever the transport takes at a time, what comes out is whole frames in order."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.links.stream import Outbox


@given(
    st.lists(st.tuples(st.integers(1, 60), st.booleans()), max_size=60),
    st.lists(st.integers(0, 40), max_size=200),
    st.integers(0, 120),
)
def test_stream_stays_framed(sends: list[tuple[int, bool]], room: list[int], limit: int) -> None:
    """Frames of any length, flushes in between, a transport that takes any number of bytes: whole frames, in order."""
    wire = bytearray()
    takes = iter(room)

    def write(data: bytes) -> int:
        taken = min(len(data), next(takes, 0))
        wire.extend(data[:taken])
        return taken

    outbox = Outbox(limit)
    accepted = bytearray()
    for number, (length, flush) in enumerate(sends):
        frame = bytes([number]) * length
        waiting = len(outbox)
        if outbox.send(write, frame):
            accepted += frame
        else:
            assert waiting > 0, "an empty outbox takes any frame"
        assert len(outbox) <= max(limit, 60)
        if flush:
            outbox.flush(write)
    assert accepted.startswith(wire)
    assert len(outbox) == len(accepted) - len(wire)
    takes = iter([len(outbox)])
    outbox.flush(write)
    assert wire == accepted


def test_clear_forgets_the_half_frame() -> None:
    outbox = Outbox(100)
    assert outbox.send(lambda data: 3, b"abcdef")
    assert len(outbox) == 3
    outbox.clear()
    wire = bytearray()

    def write(data: bytes) -> int:
        wire.extend(data)
        return len(data)

    assert outbox.send(write, b"next")
    assert wire == b"next"


def test_failed_write_keeps_nothing_of_the_new_frame() -> None:
    def gone(data: bytes) -> int:
        raise ConnectionResetError

    outbox = Outbox(100)
    with pytest.raises(ConnectionResetError):
        outbox.send(gone, b"frame")
    assert len(outbox) == 0
