"""RTCM 3's frames, held against pyrtcm, and what garbage costs."""

from __future__ import annotations

import os
import time

import pytest
from pyrtcm import RTCMReader
from pyrtcm.rtcmhelpers import calc_crc24q

from tests.rtcm import HOME, STATION, base_at, message, satellites
from zmav import geo
from zmav.formats.rtcm3 import MOST_INSIDE, PREAMBLE, Cutter, Message, crc24q, frame, split

pytestmark = pytest.mark.unit


def test_crc_is_the_one_of_pyrtcm() -> None:
    for size in (1, 3, 64, 500):
        data = os.urandom(size)
        assert crc24q(data) == calc_crc24q(data)


def test_pyrtcm_reads_what_is_made_here() -> None:
    found = RTCMReader.parse(base_at())
    here = geo.to_ecef(*HOME)
    assert (found.identity, found.DF003) == ("1005", STATION)
    for told, part in zip((found.DF025, found.DF026, found.DF027), here, strict=True):
        assert told == pytest.approx(part, abs=1e-4)
    msm = RTCMReader.parse(satellites(1074, t_ms=1000))
    assert (msm.identity, msm.NSat, msm.DF004) == ("1074", 8, 1000)


def test_fields_of_a_base() -> None:
    one = Message(base_at())
    assert (one.number, one.station, one.observes) == (1005, STATION, False)
    assert one.place is not None
    assert one.place.distance(type(one.place)(*geo.to_ecef(*HOME))) < 1e-3
    assert geo.from_ecef(one.place) == pytest.approx(HOME, abs=1e-3)


@pytest.mark.parametrize(("number", "observes", "station"), [(1077, True, 7), (1004, True, 7), (1230, False, 7)])
def test_what_a_message_says_of_itself(number: int, observes: bool, station: int) -> None:
    one = Message(message(number, station=station))
    assert (one.number, one.observes, one.station, one.place) == (number, observes, station, None)


def test_ephemerides_and_proprietary_messages_name_no_station() -> None:
    assert Message(message(1019)).station is None
    assert Message(message(4072)).station is None
    assert Message(frame(b"\x01")).number == 0


def test_messages_are_found_however_they_are_cut() -> None:
    wanted = [base_at(), message(1077, size=MOST_INSIDE), message(1087), satellites()]
    stream = b"$GNGGA,,*00\r\n" + wanted[0] + b"\xb5\x62\x01\xd3\x00" + wanted[1] + wanted[2] + b"\xd3" + wanted[3]
    for step in (1, 7, 100, len(stream)):
        cutter, found = Cutter(), list[Message]()
        for at in range(0, len(stream), step):
            found += cutter.feed(stream[at : at + step])
        assert [each.data for each in found] == wanted


def test_a_wrong_byte_costs_its_message_alone() -> None:
    bad = bytearray(message(1087))
    bad[20] ^= 1
    cutter = Cutter()
    assert [each.number for each in cutter.feed(message(1077) + bytes(bad) + message(1097))] == [1077, 1097]
    assert cutter.wrong >= 1


def test_split_takes_whole_messages_and_nothing_besides() -> None:
    data = base_at() + message(1077)
    assert [each.number for each in split(data) or ()] == [1005, 1077]
    for wrong in (data[:-1], data + b"\0", b"x" + data, data[1:]):
        assert split(wrong) is None
    assert split(b"") == []


def test_a_length_of_nothing_is_no_message() -> None:
    assert Cutter().feed(frame(b"")) == []


def test_garbage_made_to_be_costly_is_not() -> None:
    """Beginnings everywhere: each would have a kilobyte's CRC be worked out."""
    garbage = bytes((PREAMBLE, 0x03, 0xFF)) * 100_000
    cutter, began = Cutter(), time.process_time()
    for at in range(0, len(garbage), 4096):
        assert not cutter.feed(garbage[at : at + 4096])
    assert time.process_time() - began < 2.0
    assert cutter.feed(bytes(1200) + message(1077))[-1].number == 1077
