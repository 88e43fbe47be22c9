"""Signing, held against pymavlink's own in both directions; keys, old timestamps, and what survives a restart."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from zmav.errors import BadConfig, BadMessage
from zmav.mavlink import Packer, Splitter, encode, load_dialect, parse_frame
from zmav.mavlink.signing import KEEP_EVERY, TICKS, Signing, SigningClock, new_key, read_key, write_key

DIALECT = load_dialect()
KEY = bytes(range(32))
NOW = 1_800_000_000.0


def signing(key: bytes = KEY, now: float = NOW, **more: Any) -> Signing:
    return Signing(key, DIALECT, clock=SigningClock(now=lambda: now), **more)


def theirs(key: bytes = KEY, timestamp: int = 0, link_id: int = 3) -> Any:
    """pymavlink, signing what it sends and refusing what is not signed."""
    mav = ardupilotmega.MAVLink(None, srcSystem=7, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing = key, True
    mav.signing.timestamp, mav.signing.link_id = timestamp or int((NOW - 1_420_070_400) * TICKS), link_id
    return mav


def test_pymavlink_takes_what_we_sign() -> None:
    packer, ours, mav = Packer(DIALECT, 1, 191), signing(link_id=9), theirs()
    for roll in (0.0, 0.5, -0.25):
        (message,) = mav.parse_buffer(ours.sign(packer.pack("ATTITUDE", roll=roll)))
        assert (message.get_type(), message.roll, message.get_signed()) == ("ATTITUDE", roll, True)
    with pytest.raises(ardupilotmega.MAVError, match="signature"):
        mav.parse_buffer(signing(new_key()).sign(packer.pack("ATTITUDE")))


def test_we_take_what_pymavlink_signs() -> None:
    mav, ours = theirs(), signing()
    splitter = Splitter(DIALECT)
    data = b"".join(mav.param_set_encode(1, 1, b"RTL_ALT", float(n), 9).pack(mav) for n in range(3))
    frames = splitter.feed(data)
    assert [frame.signed for frame in frames] == [True] * 3
    assert [ours.accepts(frame) for frame in frames] == [True] * 3
    assert [ours.accepts(frame) for frame in frames] == [False] * 3, "played back"
    assert ours.counters.old_timestamp == 3


@given(st.integers(min_value=0, max_value=10_000), st.integers(min_value=1, max_value=255))
def test_one_bit_changed_anywhere_is_seen(at: int, flip: int) -> None:
    frame = signing().sign(Packer(DIALECT, 1, 1).pack("ATTITUDE", roll=1.0, time_boot_ms=5))
    torn = bytearray(frame)
    torn[at % len(frame)] ^= flip
    ours = signing()
    try:
        changed = parse_frame(bytes(torn), DIALECT)
    except BadMessage:
        return  # the checksum saw it
    assert not ours.accepts(changed)


@pytest.mark.parametrize(("unsigned", "passes"), [("refuse", False), ("accept", True)])
def test_unsigned_frames(unsigned: str, passes: bool) -> None:
    ours = signing(unsigned=unsigned)
    assert ours.accepts(parse_frame(encode(DIALECT, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1), DIALECT)) is passes
    assert ours.counters.unsigned == (not passes)
    radio = {f.name: 0 for f in DIALECT.message("RADIO_STATUS").fields}
    assert ours.accepts(parse_frame(encode(DIALECT, "RADIO_STATUS", radio, sysid=51, compid=68), DIALECT))


HEARTBEAT = {"type": 2, "autopilot": 3, "base_mode": 0, "custom_mode": 0, "system_status": 4}


def test_a_new_stream_may_be_a_minute_behind_and_no_more() -> None:
    ticks = int((NOW - 1_420_070_400) * TICKS)
    for behind, passes in ((59, True), (61, False)):
        mav = theirs(timestamp=ticks - behind * TICKS)
        frame = parse_frame(bytes(mav.heartbeat_encode(2, 3, 0, 0, 4).pack(mav)), DIALECT)
        assert signing().accepts(frame) is passes


def test_a_peer_that_is_ahead_moves_our_clock_on() -> None:
    """Or a companion without a clock would be refused for ever by an autopilot that has GPS time."""
    ahead = int((NOW - 1_420_070_400) * TICKS) + 3600 * TICKS
    mav, ours = theirs(timestamp=ahead), signing(now=0.0)
    assert ours.accepts(parse_frame(bytes(mav.heartbeat_encode(2, 3, 0, 0, 4).pack(mav)), DIALECT))
    sent = ours.sign(Packer(DIALECT, 1, 1).pack("HEARTBEAT"))
    assert int.from_bytes(sent[-12:-6], "little") > ahead


def test_what_cannot_be_signed() -> None:
    with pytest.raises(BadMessage, match="MAVLink 1"):
        signing().sign(encode(DIALECT, "HEARTBEAT", HEARTBEAT, sysid=1, compid=1, version=1))
    unknown = bytearray(Packer(DIALECT, 1, 1).pack("HEARTBEAT"))
    unknown[7:10] = (44010).to_bytes(3, "little")
    with pytest.raises(BadMessage, match="lacks"):
        signing().sign(bytes(unknown))


def test_timestamps_grow_through_restarts_and_broken_clocks(tmp_path: Path) -> None:
    state, now = tmp_path / "signing", [NOW]
    used: list[int] = []
    for start in (NOW, NOW - 86_400.0, 0.0):  # the clock was set back, then the battery of the clock was empty
        now[0] = start
        clock = SigningClock(state, now=lambda: now[0])
        for _ in range(50):
            now[0] += 1.0
            used.append(clock.next())
        clock.close()
    assert used == sorted(set(used))
    state.write_text("torn")
    assert SigningClock(state, now=lambda: NOW).next() == int((NOW - 1_420_070_400) * TICKS)


def test_a_timestamp_beyond_all_that_fit_costs_no_frame() -> None:
    """A peer may hold such a one, by SETUP_SIGNING or in a frame with the key."""
    clock = SigningClock(now=lambda: NOW)
    clock.heard((1 << 64) - 1)
    assert [clock.next(), clock.next()] == [(1 << 48) - 1] * 2
    signing = Signing(bytes(32), DIALECT, clock=clock)
    assert len(signing.sign(Packer(DIALECT, 1, 1).pack("HEARTBEAT"))) > 21


def test_what_is_kept_covers_what_may_have_been_used(tmp_path: Path) -> None:
    state = tmp_path / "signing"
    clock = SigningClock(state, now=lambda: NOW)
    first = clock.next()
    last = [clock.next() for _ in range(100)][-1]
    assert last - first < KEEP_EVERY
    clock.close()
    assert SigningClock(state, now=lambda: 0.0).next() > last  # killed before it could write again


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (KEY.hex().encode() + b"\n", KEY),
        (KEY.hex().upper().encode(), KEY),
        (b"passphrase: three drones \n", hashlib.sha256(b"three drones").digest()),
    ],
)
def test_keys_in_files(tmp_path: Path, text: bytes, key: bytes) -> None:
    file = tmp_path / "key"
    file.write_bytes(text)
    file.chmod(0o600)
    assert read_key(file) == key


@pytest.mark.parametrize("text", [b"", b"short", b"zz" * 32, KEY, b"passphrase:"])
def test_what_is_no_key(tmp_path: Path, text: bytes) -> None:
    file = tmp_path / "key"
    file.write_bytes(text)
    file.chmod(0o600)
    with pytest.raises(BadConfig, match="holds no key"):
        read_key(file)


def test_a_bad_key_is_not_shown(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("hunter2 but too short")
    file.chmod(0o600)
    with pytest.raises(BadConfig) as caught:
        read_key(file)
    assert "hunter2" not in f"{caught.value} {caught.value.detail}"


def test_a_key_others_can_read_is_refused_with_what_to_do(tmp_path: Path) -> None:
    file = tmp_path / "key"
    write_key(file, KEY)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert read_key(file) == KEY
    file.chmod(0o640)
    with pytest.raises(BadConfig, match=f"chmod 600 {file}"):
        read_key(file)
    with pytest.raises(BadConfig, match=r"cannot write the key .*exists"):
        write_key(file, KEY)
    with pytest.raises(BadConfig, match="cannot read the key"):
        read_key(tmp_path / "absent")
