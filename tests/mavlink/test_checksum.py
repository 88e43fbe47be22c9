"""The checksum, against pymavlink's pure-Python one."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from zmav.mavlink.checksum import BEFORE_MAGIC_V2, checksum, crc, residue_of, residues


def slow(data: bytes) -> int:
    judge = x25crc()
    judge.accumulate(list(data))
    return int(judge.crc)


@given(st.binary(max_size=280), st.integers(0, 255))
def test_checksum_is_mavlinks(body: bytes, crc_extra: int) -> None:
    assert checksum(body, crc_extra) == slow(body + bytes([crc_extra]))


def test_the_magic_byte_leaves_the_start_value() -> None:
    assert crc(b"\xfd", BEFORE_MAGIC_V2) == 0xFFFF


@given(st.binary(min_size=9, max_size=264), st.integers(0, 255), st.integers(0, 0xFFFF))
def test_whole_frames_are_summed_up_as_the_definition_says(body: bytes, crc_extra: int, wrong: int) -> None:
    """The quick check accepts the right checksum and no other, for every crc_extra."""

    def good(found: int) -> bool:
        frame = b"\xfd" + body + found.to_bytes(2, "little")
        return crc(frame, BEFORE_MAGIC_V2) == residues()[found] ^ residue_of(crc_extra)

    right = slow(body + bytes([crc_extra]))
    assert good(right)
    assert good(wrong) == (wrong == right)
    assert not good(right ^ 0x0001)


def test_another_magic_byte_is_noticed() -> None:
    body = bytes(range(20))
    found = checksum(body, 50)
    for magic in set(range(256)) - {0xFD}:
        summed = crc(bytes([magic]) + body + found.to_bytes(2, "little"), BEFORE_MAGIC_V2)
        assert summed != residues()[found] ^ residue_of(50)
