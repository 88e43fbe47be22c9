"""The light check for MAVLink: sure of real streams, deaf to noise and to real streams heard at the wrong rate."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import ardupilotmega as v1
from pymavlink.dialects.v20 import ardupilotmega as v2

from zmav.links.serial import CANDIDATES, NOISE, MavlinkDetector, is_mavlink


def stream(dialect: object, count: int, sysid: int = 1, signed: bool = False) -> list[bytes]:
    """``count`` frames of several kinds, packed by pymavlink."""
    mav = dialect.MAVLink(None, srcSystem=sysid, srcComponent=1)  # type: ignore[attr-defined] # a generated module
    if signed:
        mav.signing.secret_key = bytes(range(32))
        mav.signing.link_id, mav.signing.timestamp, mav.signing.sign_outgoing = 1, 1, True
    frames = []
    for n in range(count):
        message = [
            lambda n=n: mav.attitude_encode(n, 0.1 * n, -0.2, 0.3, 0.0, 0.01, 0.02),
            lambda n=n: mav.system_time_encode(1_700_000_000_000_000 + n, n),
            lambda n=n: mav.statustext_encode(6, b"message %d" % n),
        ][n % 3]()
        frames.append(message.pack(mav))
        mav.seq = (mav.seq + 1) % 256
    return [bytes(frame) for frame in frames]


def heartbeat(dialect: object) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)  # type: ignore[attr-defined] # a generated module
    return bytes(mav.heartbeat_encode(2, 3, 81, 4, 4, 3).pack(mav))


@pytest.mark.parametrize("dialect", [v1, v2])
def test_one_heartbeat_is_enough(dialect: object) -> None:
    frame = heartbeat(dialect)
    assert is_mavlink(frame)
    assert is_mavlink(b"noise \xfd\xfe" + frame + b"\xfe")
    for at in range(1, len(frame)):
        spoiled = bytearray(frame)
        spoiled[at] ^= 0x40
        assert not is_mavlink(spoiled), f"byte {at} spoiled"
    assert not is_mavlink(frame[:-1])


@pytest.mark.parametrize(("dialect", "signed"), [(v1, False), (v2, False), (v2, True)])
def test_three_frames_in_a_row_are_enough(dialect: object, signed: bool) -> None:
    frames = stream(dialect, 6, signed=signed)
    assert is_mavlink(b"".join(frames[:3]))
    assert is_mavlink(frames[0][5:] + b"".join(frames[1:4]))  # joined in the middle of a frame
    assert not is_mavlink(b"".join(frames[:2]))
    assert not is_mavlink(frames[0] + frames[1] + b"\x00" + frames[2]), "not in a row"
    assert not is_mavlink(frames[0] + frames[1] + frames[3]), "a sequence number is missing"


def test_several_sources_on_one_line() -> None:
    one, other = stream(v2, 4, sysid=1), stream(v2, 4, sysid=2)
    assert is_mavlink(one[0] + other[0] + one[1])
    assert not is_mavlink(one[0] + other[0] + stream(v2, 1, sysid=3)[0]), "three strangers prove nothing"


@given(st.binary(max_size=2000))
def test_random_bytes_never_raise(data: bytes) -> None:
    assert is_mavlink(data) in (True, False)


@given(st.integers(0, 255), st.integers(0, 2000))
def test_one_byte_repeated_is_noise(byte: int, count: int) -> None:
    assert not is_mavlink(bytes([byte]) * count)


def test_a_detector_makes_up_its_mind() -> None:
    detector = MavlinkDetector()
    frame = heartbeat(v2)
    assert detector.hear(b"") is None
    assert detector.hear(frame[:10]) is None
    assert detector.hear(frame[10:]) is True
    assert bytes(detector.heard) == frame
    deaf = MavlinkDetector()
    assert deaf.hear(bytes(NOISE - 1)) is None
    assert deaf.hear(b"\x00") is False


def on_the_wire(data: bytes, sent: int, heard: int) -> bytes:
    """What a UART at ``heard`` baud makes of bytes sent in a row at ``sent`` baud (8N1, sampled in mid-bit)."""
    line = [level for byte in data for level in (0, *((byte >> bit) & 1 for bit in range(8)), 1)]
    step = sent / heard
    out = bytearray()
    at = 0.0
    while at + 10 * step < len(line) and len(out) < 3 * NOISE:  # more than a detector listens to
        if line[int(at)] != 0:  # idle or a stop bit: wait for the next start bit
            at = int(at) + 1.0
            continue
        bits = [line[int(at + (bit + 1.5) * step)] for bit in range(8)]
        out.append(sum(bit << place for place, bit in enumerate(bits)))
        at += 9.5 * step  # in the middle of the stop bit it looks out for the next start
    return bytes(out)


def test_the_model_of_the_wire_is_true_at_the_right_rate() -> None:
    data = bytes(range(256))
    assert on_the_wire(data + b"\xff\xff", 57600, 57600)[:256] == data


@pytest.mark.parametrize("sent", CANDIDATES)
def test_real_stream_at_a_wrong_rate_is_noise(sent: int) -> None:
    mixed = b"".join(frame + heartbeat(v2) for frame in stream(v2, 24))
    assert is_mavlink(mixed)
    for heard in CANDIDATES:
        if heard != sent:
            assert not is_mavlink(on_the_wire(mixed, sent, heard)), f"sent at {sent}, heard at {heard}"


@pytest.mark.parametrize("name", ["copter", "plane", "rover", "px4", "px4_three", "copter_params"])
def test_any_piece_of_a_recorded_stream_is_heard(shared_data: Path, name: str) -> None:
    log = (shared_data / f"{name}.tlog").read_bytes()
    frames, at = [], 0
    while at < len(log):
        length = log[at + 9] + 12 + (13 if log[at + 10] & 1 else 0)
        frames.append(log[at + 8 : at + 8 + length])
        at += 8 + length
    line = b"".join(frames)
    heard = [is_mavlink(line[start : start + NOISE]) for start in range(7, len(line) - NOISE, 4001)]
    # Where the recording (of UDP) lost frames, or three vehicles alternate, a piece may hold no unbroken row.
    assert sum(heard) >= 0.95 * len(heard)
    noise = bytes(byte ^ 0xA5 for byte in line)
    assert not any(is_mavlink(noise[start : start + NOISE]) for start in range(7, len(line) - NOISE, 4001))
