"""GPS_RTCM_DATA: cut and put together, as ArduPilot does it (AP_GPS::handle_gps_rtcm_fragment)."""

from __future__ import annotations

import os

import pytest

from zmav.mavlink.rtcm import MOST_PIECES, PIECE, WHOLE, Joiner, cut, fields, sequences

pytestmark = pytest.mark.unit


def joined(data: bytes, sequence: int) -> bytes:
    joiner, found = Joiner(), b""
    for flags, piece in cut(data, sequence):
        told = fields(flags, piece)
        assert len(told["data"]) == PIECE
        found += joiner.add(told["flags"], told["len"], told["data"])
    return found


@pytest.mark.parametrize("size", [1, 179, 180, 181, 359, 360, 361, 539, 540, 541, 719, 720, 721, 900, 1029])
def test_what_is_cut_comes_together(size: int) -> None:
    data = os.urandom(size)
    assert joined(data, 30) == data
    assert sequences(data) == 1 + (size > WHOLE)


def test_flags_are_those_of_the_protocol() -> None:
    assert [flags for flags, _ in cut(bytes(100), 5)] == [5 << 3]
    assert [(flags, len(piece)) for flags, piece in cut(bytes(360), 31)] == [
        (31 << 3 | 1, 180),
        (31 << 3 | 2 | 1, 180),
        (31 << 3 | 4 | 1, 0),  # or nobody would know that it is over
    ]
    assert [flags for flags, _ in cut(bytes(720), 0)] == [1, 3, 5, 7]
    assert all(0 <= flags <= 255 for flags, _ in cut(bytes(1029), 31))


def test_a_lost_fragment_loses_its_sequence_alone() -> None:
    joiner = Joiner()
    first, second = list(cut(b"a" * 500, 1)), list(cut(b"b" * 500, 2))
    for flags, piece in (first[0], first[2]):
        assert joiner.add(flags, len(piece), piece) == b""
    assert b"".join(joiner.add(flags, len(piece), piece) for flags, piece in second) == b"b" * 500


def test_fragments_out_of_order_come_together() -> None:
    joiner, data = Joiner(), os.urandom(500)
    assert b"".join(joiner.add(flags, len(piece), piece) for flags, piece in reversed(list(cut(data, 9)))) == data


def test_a_sender_that_lies_fills_no_memory() -> None:
    joiner = Joiner()
    for i in range(10_000):
        assert len(joiner.add(i % 256, 255, os.urandom(PIECE))) <= MOST_PIECES * PIECE
