"""One frame: its header, building one, and parse_frame's verdicts."""

from __future__ import annotations

from types import ModuleType

import pytest

from zmav.errors import BadMessage
from zmav.mavlink import Dialect, Frame, Packer, encode, parse_frame
from zmav.mavlink.frame import build_frame

HEARTBEAT = {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 4, "system_status": 4}


def test_header_of_mavlink_2(dialect: Dialect) -> None:
    data = encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=7, compid=191, seq=200)
    frame = parse_frame(data, dialect)
    assert (frame.version, frame.sysid, frame.compid, frame.seq, frame.msgid) == (2, 7, 191, 200, 0)
    assert (frame.signed, frame.incompat_flags, frame.verified) == (False, 0, True)
    assert frame.payload == bytes([4, 0, 0, 0, 2, 3, 81, 4, 3])
    assert frame.data == data


def test_header_of_mavlink_1(dialect: Dialect) -> None:
    data = encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=7, compid=191, seq=200, version=1)
    frame = parse_frame(data, dialect)
    assert (frame.version, frame.sysid, frame.compid, frame.seq, frame.msgid) == (1, 7, 191, 200, 0)
    assert (frame.signed, frame.incompat_flags, frame.verified) == (False, 0, True)
    assert frame.payload == bytes([4, 0, 0, 0, 2, 3, 81, 4, 3])


def test_signed_frame_of_pymavlink(dialect: Dialect, pymav: ModuleType) -> None:
    data = signed_heartbeat(pymav)
    frame = parse_frame(data, dialect)
    assert frame.signed
    assert frame.incompat_flags == 1
    assert len(data) == 12 + 9 + 13
    assert frame.payload == bytes([4, 0, 0, 0, 2, 3, 81, 4, 3])


def signed_heartbeat(pymav: ModuleType) -> bytes:
    sender = pymav.MAVLink(None, srcSystem=7, srcComponent=191)
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    return bytes(pymav.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3).pack(sender))


def test_payload_keeps_at_least_one_byte(dialect: Dialect) -> None:
    message = dialect.message("SYSTEM_TIME")
    frame = build_frame(message, bytes(message.max_length), 1, 1, 0)
    assert frame[1] == 1
    assert len(frame) == 13
    assert parse_frame(frame, dialect).payload == b"\0"


def test_mavlink_1_keeps_its_zeros(dialect: Dialect) -> None:
    message = dialect.message("SYSTEM_TIME")
    frame = build_frame(message, bytes(message.base_length), 1, 1, 0, version=1)
    assert frame[1] == message.base_length
    assert len(frame) == message.base_length + 8


def test_a_longer_payload_than_the_dialects_is_fine(dialect: Dialect) -> None:
    message = dialect.message("HEARTBEAT")
    data = build_frame(message, bytes(range(1, 60)), 1, 1, 0)
    assert parse_frame(data, dialect).payload == bytes(range(1, 60))


def test_unknown_message_is_taken_on_trust() -> None:
    from zmav.mavlink import load_dialect

    minimal = load_dialect("minimal")
    data = Packer(load_dialect(), 3, 4).pack("ATTITUDE", roll=1.5)
    frame = parse_frame(data, minimal)
    assert (frame.msgid, frame.verified, frame.data) == (30, False, data)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda good: b"", "does not begin"),
        (lambda good: b"\x55" + good[1:], "does not begin with 0xFD or 0xFE"),
        (lambda good: good[:11], "11 bytes are too few"),
        (lambda good: good[:-1], "it has 20 bytes, but 21 by its header"),
        (lambda good: good + b"\0", "it has 22 bytes, but 21 by its header"),
        (lambda good: good + good, "it has 42 bytes, but 21 by its header"),
        (lambda good: good[:2] + b"\x02" + good[3:], "flags 0x02 are not understood"),
        (lambda good: good[:2] + b"\x81" + good[3:], "flags 0x81 are not understood"),
        (lambda good: good[:-1] + bytes([good[-1] ^ 1]), "checksum of HEARTBEAT"),
        (lambda good: good[:12] + bytes([good[12] ^ 64]) + good[13:], "checksum of HEARTBEAT"),
        (lambda good: b"\xfe\x01\x00\x01\x01\x00\x04\x00\x00", "HEARTBEAT has 9 payload bytes in MAVLink 1, not 1"),
        (lambda good: b"\xfe\x09", "2 bytes are too few for a MAVLink 1 frame"),
    ],
)
def test_parse_frame_says_why_not(dialect: Dialect, change: object, reason: str) -> None:
    assert callable(change)
    data = change(encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1))
    with pytest.raises(BadMessage, match=reason) as caught:
        parse_frame(data, dialect)
    assert reason in caught.value.detail["reason"]
    assert caught.value.detail["value"] == data.hex()


def test_frames_cannot_be_changed(dialect: Dialect) -> None:
    frame = parse_frame(encode(dialect, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1), dialect)
    with pytest.raises(AttributeError):
        frame.msgid = 3  # type: ignore[misc]
    assert frame == Frame(frame.data, 0, True)
