"""Any chopping of any stream gives the same frames and counters: those of a slow, plain reading of the rules."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from zmav.mavlink import Dialect, Packer, Splitter, load_dialect
from zmav.mavlink.frame import build_frame

DIALECT = load_dialect()
NAMES = ["HEARTBEAT", "ATTITUDE", "SYS_STATUS", "STATUSTEXT", "AUTOPILOT_VERSION", "COMMAND_LONG", "GPS_RAW_INT"]


@st.composite
def good(draw: st.DrawFn, versions: tuple[int, ...] = (1, 2)) -> bytes:
    message = DIALECT.message(draw(st.sampled_from(NAMES)))
    version = draw(st.sampled_from(versions))
    size = message.base_length if version == 1 else message.max_length
    payload = draw(st.binary(min_size=size, max_size=size))
    return build_frame(message, payload, draw(st.integers(1, 2)), 1, draw(st.integers(0, 255)), version)


@st.composite
def signed(draw: st.DrawFn) -> bytes:
    frame = draw(good((2,)))
    crc_extra = DIALECT.by_id[int.from_bytes(frame[7:10], "little")].crc_extra
    body = frame[1:2] + b"\x01" + frame[3:-2]
    return b"\xfd" + body + slow_crc(body, crc_extra).to_bytes(2, "little") + draw(st.binary(min_size=13, max_size=13))


@st.composite
def unknown(draw: st.DrawFn) -> bytes:
    payload = draw(st.binary(max_size=40))
    head = bytes([draw(st.integers(0, 255)), draw(st.integers(1, 2)), 1])
    if draw(st.booleans()):
        return b"\xfe" + bytes([len(payload)]) + head + b"\xff" + payload + draw(st.binary(min_size=2, max_size=2))
    flags = draw(st.sampled_from([0, 0, 1]))
    tail = draw(st.binary(min_size=2 + 13 * flags, max_size=2 + 13 * flags))
    return b"\xfd" + bytes([len(payload), flags, 0]) + head + b"\x9a\x01\x00" + payload + tail


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    frame = draw(good() | signed() | unknown())
    place = draw(st.integers(0, len(frame) - 1))
    how = draw(st.sampled_from(["flip", "cut", "flags"]))
    if how == "cut":
        return frame[:place]
    if how == "flags":
        return frame[:2] + bytes([draw(st.integers(2, 255))]) + frame[3:]
    return frame[:place] + bytes([frame[place] ^ draw(st.integers(1, 255))]) + frame[place + 1 :]


garbage = st.binary(max_size=30) | st.lists(st.sampled_from([0xFD, 0xFE, 0, 1, 9]), max_size=30).map(bytes)
pieces = st.lists(good() | good((2,)) | signed() | unknown() | damaged() | garbage, max_size=12)
streams = pieces.map(b"".join)


def slow_crc(body: bytes, crc_extra: int) -> int:
    judge = x25crc()
    judge.accumulate([*body, crc_extra])
    return int(judge.crc)


def read_slowly(stream: bytes, dialect: Dialect) -> Iterator[tuple[bytes, int, bool]]:
    """The rules of the splitter, said once more and as plainly as possible: (data, msgid, verified) of every frame."""
    pos, in_step = 0, True
    while pos < len(stream):
        rest = stream[pos:]
        size = 0
        header = {0xFD: 10, 0xFE: 6}.get(rest[0])
        flags = rest[2] if rest[0] == 0xFD and len(rest) > 2 else 0
        if header and flags in (0, 1):
            if len(rest) < header:
                return
            msgid = int.from_bytes(rest[7:10], "little") if header == 10 else rest[5]
            end = header + rest[1]
            size = end + 2 + 13 * flags
            message = dialect.by_id.get(msgid)
            short = message and header == 6 and rest[1] < message.base_length
            if short or (message is None and not in_step):
                size = 0
            elif len(rest) < size:
                return
            elif message and slow_crc(rest[1:end], message.crc_extra) != int.from_bytes(rest[end : end + 2], "little"):
                size = 0
            else:
                yield rest[:size], msgid, message is not None
        in_step = size > 0
        pos += size or 1


def chopped(stream: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({cut % (len(stream) + 1) for cut in cuts})
    return [stream[a:b] for a, b in zip([0, *places], [*places, len(stream)], strict=True)]


def outcome(parts: list[bytes]) -> tuple[object, ...]:
    splitter = Splitter(DIALECT)
    frames = [frame for part in parts for frame in splitter.feed(part)]
    sources = {key: asdict(source) for key, source in splitter.sources.items()}
    return frames, asdict(splitter.counters), sources, splitter.partial


@given(pieces, st.lists(st.integers(0, 3000), max_size=12))
@settings(max_examples=250)
def test_chopping_changes_nothing(datagrams: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(datagrams)
    whole = outcome([stream])
    assert outcome(datagrams) == whole
    assert outcome(chopped(stream, cuts)) == whole
    assert outcome([stream[k : k + 1] for k in range(len(stream))]) == whole


@given(streams, st.lists(st.integers(0, 3000), max_size=4))
@settings(max_examples=250)
def test_frames_are_those_of_the_rules(stream: bytes, cuts: list[int]) -> None:
    splitter = Splitter(DIALECT)
    # Seen routes take the fast paths: let them be seen first.
    packer = Packer(DIALECT, 1, 1)
    seen = [packer.pack(name) for name in NAMES]
    for data in seen:
        splitter.feed(data)
    frames = [frame for part in chopped(stream, cuts) for frame in splitter.feed(part)]
    assert [(f.data, f.msgid, f.verified) for f in frames] == list(read_slowly(stream, DIALECT))
    counters = splitter.counters
    assert counters.bytes == len(stream) + sum(map(len, seen))
    assert counters.frames == len(frames) + len(seen)
    assert counters.unknown == sum(not f.verified for f in frames)
    assert counters.bytes == counters.garbage + len(splitter.partial) + sum(len(f.data) for f in frames) + sum(
        map(len, seen)
    )
    assert counters.lost == sum(source.lost for source in splitter.sources.values())


@given(st.lists(st.tuples(good(), st.binary(max_size=20)), max_size=8), st.lists(st.integers(0, 3000), max_size=6))
@settings(max_examples=150)
def test_frames_between_garbage_without_magic_bytes_are_all_found(
    pairs: list[tuple[bytes, bytes]], cuts: list[int]
) -> None:
    noise = [noise.translate(None, b"\xfd\xfe") for _, noise in pairs]
    stream = b"".join(n + frame for (frame, _), n in zip(pairs, noise, strict=True))
    splitter = Splitter(DIALECT)
    frames = [frame.data for part in chopped(stream, cuts) for frame in splitter.feed(part)]
    assert frames == [frame for frame, _ in pairs]
    assert splitter.counters.garbage == sum(map(len, noise))
    assert splitter.counters.bad_crc == splitter.counters.bad_flags == splitter.counters.bad_length == 0
