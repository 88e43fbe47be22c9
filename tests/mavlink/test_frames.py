"""The splitter by example: what is a frame, what is counted, what is lost."""

from __future__ import annotations

import random
from types import ModuleType

import pytest

from zmav.mavlink import Dialect, Packer, Splitter, load_dialect
from zmav.mavlink.checksum import checksum
from zmav.mavlink.frame import MAGIC_V2, build_frame


def heartbeat(dialect: Dialect, seq: int, *, sysid: int = 1, compid: int = 1, version: int = 2) -> bytes:
    payload = bytes([4, 0, 0, 0, 2, 3, 81, 4, 3])
    return build_frame(dialect.message("HEARTBEAT"), payload, sysid, compid, seq, version)


def unknown(seq: int, *, msgid: int = 44010, sysid: int = 1, compid: int = 1, payload: bytes = b"abc") -> bytes:
    """A frame of a message that no dialect here has; its checksum may be anything."""
    return (
        bytes([MAGIC_V2, len(payload), 0, 0, seq, sysid, compid]) + msgid.to_bytes(3, "little") + payload + b"\x12\x34"
    )


def feed_all(splitter: Splitter, *parts: bytes) -> list[bytes]:
    return [frame.data for part in parts for frame in splitter.feed(part)]


def test_one_frame_a_datagram(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    sent = [heartbeat(dialect, seq & 0xFF) for seq in range(600)]
    assert feed_all(splitter, *sent) == sent
    assert splitter.counters.frames == len(sent)
    assert splitter.counters.bytes == sum(map(len, sent))
    assert splitter.counters.garbage == splitter.counters.lost == 0
    assert splitter.sources[1, 1].frames == len(sent)


def test_several_frames_and_a_torn_one(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    a, b, c = (heartbeat(dialect, seq) for seq in range(3))
    assert feed_all(splitter, a + b + c[:5]) == [a, b]
    assert feed_all(splitter, c[5:]) == [c]
    assert splitter.counters.frames == 3


@pytest.mark.parametrize("version", [1, 2])
def test_both_versions_and_signed_between(dialect: Dialect, pymav: ModuleType, version: int) -> None:
    sender = pymav.MAVLink(None, srcSystem=1, srcComponent=1)
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    sender.seq = 1
    signed = bytes(pymav.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3).pack(sender))
    sent = [heartbeat(dialect, 0, version=version), signed, heartbeat(dialect, 2, version=version)]
    splitter = Splitter(dialect)
    assert feed_all(splitter, b"".join(sent)) == sent
    assert (splitter.counters.lost, splitter.counters.garbage, splitter.counters.unknown) == (0, 0, 0)


def test_garbage_is_passed_over_and_counted(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    a, b = heartbeat(dialect, 0), heartbeat(dialect, 1)
    assert feed_all(splitter, b"noise" + a + b"more noise" + b) == [a, b]
    assert splitter.counters.garbage == len(b"noise" + b"more noise")
    assert splitter.counters.bytes == splitter.counters.garbage + len(a + b)


def test_bad_checksum_loses_that_frame_only(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    a, b, c = (heartbeat(dialect, seq) for seq in range(3))
    damaged = b[:12] + bytes([b[12] ^ 1]) + b[13:]
    assert feed_all(splitter, a, damaged, c) == [a, c]
    assert splitter.counters.bad_crc == 1
    assert splitter.counters.garbage == len(b)
    assert splitter.counters.lost == splitter.sources[1, 1].lost == 1


def test_a_frame_inside_a_damaged_one_is_found(dialect: Dialect) -> None:
    """Resynchronising goes byte by byte, so that a wrong length does not swallow what follows."""
    splitter = Splitter(dialect)
    a, b = heartbeat(dialect, 0), heartbeat(dialect, 1)
    too_long = bytes([a[0], 60]) + a[2:]
    assert feed_all(splitter, too_long + b + heartbeat(dialect, 2) * 3)[0] == b


@pytest.mark.parametrize("flags", [0x02, 0x03, 0x04, 0x80, 0xFF])
def test_flags_that_are_not_understood_are_refused(dialect: Dialect, flags: int) -> None:
    splitter = Splitter(dialect)
    a, b = heartbeat(dialect, 0), heartbeat(dialect, 1)
    assert feed_all(splitter, a[:2] + bytes([flags]) + a[3:] + b) == [b]
    assert splitter.counters.bad_flags == 1
    assert splitter.counters.bad_crc == 0


@pytest.mark.parametrize(("place", "value"), [(0, 8), (0, 10), (1, 0x02), (1, 0x01), (1, 0x80)])
def test_a_right_checksum_does_not_excuse_length_or_flags(dialect: Dialect, place: int, value: int) -> None:
    """In one datagram, from a sender that is known already: what the fast path sees most."""
    good = heartbeat(dialect, 0)
    body = bytearray(good[1:-2])
    body[place] = value
    forged = b"\xfd" + body + checksum(bytes(body), dialect.message("HEARTBEAT").crc_extra).to_bytes(2, "little")
    splitter = Splitter(dialect)
    splitter.feed(good)
    assert feed_all(splitter, forged) == []


def test_refused_flags_are_refused_at_the_third_byte(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    assert feed_all(splitter, b"\xfd\xff\x02") == []
    assert splitter.counters.bad_flags == 1
    assert splitter.counters.garbage == 3


def test_compatibility_flags_change_nothing(dialect: Dialect) -> None:
    message = dialect.message("HEARTBEAT")
    body = bytes([1, 0, 0x55, 0, 1, 1, 0, 0, 0, 9])
    data = b"\xfd" + body + checksum(body, message.crc_extra).to_bytes(2, "little")
    for splitter in (Splitter(dialect), Splitter(dialect)):
        assert feed_all(splitter, data, data) == [data, data]
        assert splitter.counters.bad_flags == 0


def test_mavlink_1_too_short_for_its_message(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    good = heartbeat(dialect, 0)
    assert feed_all(splitter, b"\xfe\x08\x00\x01\x01\x00" + good) == [good]
    assert splitter.counters.bad_length == 1


def test_a_payload_longer_than_the_dialects_passes(dialect: Dialect) -> None:
    newer = build_frame(dialect.message("HEARTBEAT"), bytes(range(1, 100)), 1, 1, 0)
    assert feed_all(Splitter(dialect), newer, newer) == [newer, newer]


def test_unknown_messages_in_step_pass_with_their_true_ids(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    sent = [
        heartbeat(dialect, 0),
        unknown(1),
        unknown(2, msgid=0xABCDEF, payload=b"\xfd\xfe" * 20),
        heartbeat(dialect, 3),
    ]
    frames = splitter.feed(b"".join(sent))
    assert [frame.data for frame in frames] == sent
    assert [frame.msgid for frame in frames] == [0, 44010, 0xABCDEF, 0]
    assert [frame.verified for frame in frames] == [True, False, False, True]
    assert splitter.counters.unknown == 2
    assert splitter.counters.lost == 0
    assert splitter.sources[1, 1].frames == 4


def test_unknown_message_passes_at_the_streams_start_and_after_reset(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    assert feed_all(splitter, unknown(0)) == [unknown(0)]
    splitter.feed(b"garbage")
    assert feed_all(splitter, unknown(1)) == []
    splitter.reset()
    assert feed_all(splitter, unknown(2)) == [unknown(2)]


def test_unknown_messages_out_of_step_are_passed_over_at_once(dialect: Dialect) -> None:
    """No waiting for what follows: the verdict depends on what came before alone."""
    splitter = Splitter(dialect)
    good = heartbeat(dialect, 5)
    assert feed_all(splitter, b"x", unknown(1), good) == [good]
    assert splitter.counters.unknown == 0
    assert splitter.counters.garbage == 1 + len(unknown(1))
    assert feed_all(splitter, unknown(6)) == [unknown(6)]


def test_unknown_messages_out_of_step_hold_up_nothing(dialect: Dialect) -> None:
    """What looks like the head of a long unknown message must not keep back the good frame behind it."""
    splitter = Splitter(dialect)
    good = heartbeat(dialect, 5)
    assert feed_all(splitter, b"x" + unknown(1, payload=bytes(200))[:12] + good) == [good]


def test_unknown_frames_make_no_sources(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    for sysid in range(256):
        splitter.feed(unknown(0, sysid=sysid))
    assert splitter.counters.unknown == 256
    assert splitter.sources == {}


def test_unknown_mavlink_1_message() -> None:
    minimal = load_dialect("minimal")
    data = build_frame(load_dialect().message("ATTITUDE"), bytes(range(28)), 1, 1, 0, version=1)
    (frame,) = Splitter(minimal).feed(data)
    assert (frame.data, frame.msgid, frame.verified, frame.version) == (data, 30, False, 1)


@pytest.mark.parametrize(
    ("seqs", "lost", "last"),
    [
        ([0, 1, 2], 0, 2),
        ([254, 255, 0, 1], 0, 1),  # the number wraps
        ([10, 12], 1, 12),
        ([250, 5], 10, 5),
        ([1, 128], 126, 128),
        ([1, 129], 127, 129),
        ([1, 130], 0, 130),  # 128 missing: as likely a restart
        ([5, 5, 5, 6], 0, 6),  # duplicates
        ([1, 2, 4, 3, 5], 0, 5),  # overtaken, but not lost
        ([1, 2, 6, 4, 4, 7, 4], 2, 7),  # 4 came after all, thrice; 3 and 5 did not
        ([250, 3, 255, 4, 0], 6, 4),  # the same across the wrap
        ([1, 40, 8, 9, 41], 36, 41),  # 32 back, and come after all
        ([1, 40, 7, 8], 38, 8),  # 33 back: rather a restart
        ([100, 101, 70, 102], 0, 102),  # an old one again
        ([*range(10), *range(11, 256), *range(20), 10], 1, 19),  # a duplicate is not what was lost one turn ago
        ([200, 100, 101], 0, 101),  # restarted
        ([77], 0, 77),  # the first one is no loss, wherever it begins
    ],
)
@pytest.mark.parametrize("together", [False, True])
def test_losses_by_sequence_numbers(dialect: Dialect, seqs: list[int], lost: int, last: int, together: bool) -> None:
    splitter = Splitter(dialect)
    sent = [heartbeat(dialect, seq) for seq in seqs]
    assert feed_all(splitter, *([b"".join(sent)] if together else sent)) == sent
    source = splitter.sources[1, 1]
    assert (source.lost, source.last_seq, source.frames) == (lost, last, len(seqs))
    assert splitter.counters.lost == lost


def test_sources_are_counted_apart(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    splitter.feed(heartbeat(dialect, 3) + heartbeat(dialect, 90, compid=191) + heartbeat(dialect, 200, sysid=2))
    splitter.feed(heartbeat(dialect, 6) + heartbeat(dialect, 91, compid=191) + heartbeat(dialect, 202, sysid=2))
    assert {key: (s.frames, s.lost) for key, s in splitter.sources.items()} == {
        (1, 1): (2, 2),
        (1, 191): (2, 0),
        (2, 1): (2, 1),
    }
    assert splitter.counters.lost == 3


def test_messages_of_one_source_share_its_sequence(dialect: Dialect) -> None:
    packer = Packer(dialect, 1, 1)
    names = ["HEARTBEAT", "ATTITUDE", "SYS_STATUS", "ATTITUDE", "HEARTBEAT"] * 60
    splitter = Splitter(dialect)
    for name in names:
        splitter.feed(packer.pack(name, **({"roll": 1.0} if name == "ATTITUDE" else {})))
    assert splitter.counters.lost == 0
    assert splitter.sources[1, 1].frames == len(names)


def test_reset_forgets_a_torn_frame(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    a, b = heartbeat(dialect, 0), heartbeat(dialect, 1)
    splitter.feed(a + b[:7])
    splitter.reset()
    assert feed_all(splitter, b) == [b]
    assert splitter.counters.frames == 2
    assert splitter.counters.garbage == 7
    assert splitter.counters.bytes == len(a) + 7 + len(b)


def test_memory_is_bounded(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    rng = random.Random(1)
    for _ in range(200):
        splitter.feed(rng.randbytes(5000))
        assert len(splitter.partial) < 280
    # Somebody who invents senders and messages without end, with good checksums.
    quick = [message for message in dialect.by_id.values() if message.max_length < 60][:20]
    for sysid in range(256):
        for message in quick:
            splitter.feed(build_frame(message, b"\x01", sysid, 1, 0))
    assert len(splitter.sources) <= 65536
    assert 0 < len(splitter._routes) <= 4096


def test_empty_reads_are_harmless(dialect: Dialect) -> None:
    splitter = Splitter(dialect)
    data = heartbeat(dialect, 0)
    assert feed_all(splitter, b"", data[:4], b"", data[4:], b"") == [data]
