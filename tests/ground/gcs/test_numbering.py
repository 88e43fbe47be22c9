"""What a station counts as lost is what was lost, whatever was left out for it or added."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground.gcs.kinds import Numbering, renumbered
from zmav.mavlink import Splitter, encode, load_dialect, parse_frame

ATTITUDE = {
    "time_boot_ms": 7,
    "roll": 0.1,
    "pitch": 0.0,
    "yaw": -1.0,
    "rollspeed": 0.0,
    "pitchspeed": 2.0,
    "yawspeed": 0,
}
STEPS = st.lists(st.sampled_from(["passes", "held back", "added", "lost"]), max_size=120)


def attitude(seq: int, version: int = 2) -> bytes:
    return encode(load_dialect(), "ATTITUDE", ATTITUDE, sysid=3, compid=1, seq=seq, version=version)


@given(STEPS, st.integers(0, 255))
def test_only_true_losses_show(steps: list[str], first: int) -> None:
    numbers, station = Numbering(), Splitter(load_dialect())
    seq, heard, lost, due, shown = first, False, 0, 0, 0
    for step in steps:
        if step == "lost":
            lost += heard
        elif step != "added":
            numbers.came(seq)
            heard, due, lost = True, due + lost, 0
        if step in ("passes", "added"):
            began = bool(station.sources)
            station.feed(attitude(numbers.next()))
            shown, due = shown + (due if began else 0), 0
        seq = (seq + (step != "added")) & 0xFF
    assert station.counters.lost == shown


def test_numbers_go_on_where_untouched_ones_ended() -> None:
    numbers = Numbering(255, 255)
    numbers.came(0)
    assert numbers.next() == 0
    numbers.came(1)  # held back
    numbers.came(2)
    assert numbers.next() == 1


def test_what_came_late_or_twice_is_no_loss() -> None:
    numbers = Numbering(10, 10)
    for seq in (12, 11, 12):
        numbers.came(seq)
    assert numbers.next() == 12
    numbers.came(13)
    assert numbers.next() == 13


def test_a_restart_is_no_loss() -> None:
    numbers = Numbering(100, 40)
    numbers.came(0)
    assert numbers.next() == 41


@pytest.mark.parametrize("version", [1, 2])
def test_a_frame_gets_another_number(version: int) -> None:
    for seq in (0, 7, 255):
        changed = renumbered(attitude(7, version), seq)
        assert parse_frame(changed, load_dialect()).seq == seq and changed == attitude(seq, version)


def test_the_checksum_of_an_unknown_frame_is_kept_right_and_a_wrong_one_wrong() -> None:
    frame = attitude(7)
    damaged = frame[:-1] + bytes((frame[-1] ^ 1,))
    for data, good in ((frame, True), (damaged, False)):
        feed = Splitter(load_dialect()).feed(renumbered(data, 9))
        assert bool(feed) is good


def test_a_signed_frame_is_left_alone() -> None:
    signed = bytearray(attitude(7) + bytes(13))
    signed[2] = 1
    assert renumbered(bytes(signed), 9) == bytes(signed)
