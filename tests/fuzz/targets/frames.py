"""MAVLink as it comes on a link: frames, and what several of them carry together."""

from __future__ import annotations

import functools
import json
import random
import struct
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import msgspec

from tests.fuzz.engine import Target, pure
from zmav import wire, zenoh_codec
from zmav.errors import BadMessage
from zmav.mavlink import Dialect, Frame, Packer, Splitter, describe, encode, load_dialect, parse_frame
from zmav.mavlink import ftp as ftp_packets
from zmav.mavlink.checksum import checksum
from zmav.mavlink.event import read_event
from zmav.mavlink.ftp import Packet
from zmav.mavlink.plan_file import pack_header, pack_item
from zmav.mavlink.signing import Signing
from zmav.mavlink.statustext import MSGID, TextJoiner
from zmav.services.missions.by_file import PlanFile
from zmav.services.missions.items import HOME

KEY = bytes(range(32))
TX = "zmav/demo/quad1/mav/tx/1/1/COMMAND_LONG"


@functools.cache
def the_dialect() -> Dialect:
    return load_dialect()


# A stream of frames.


def split(data: bytes) -> None:
    """What must be true of any bytes, however they are chopped."""
    dialect = the_dialect()
    splitter = Splitter(dialect)
    frames = splitter.feed(data)
    counters = splitter.counters
    pending = len(splitter.partial)
    assert pending < 280
    assert counters.bytes == len(data)
    assert counters.frames == len(frames)
    assert counters.bytes == counters.garbage + pending + sum(len(frame.data) for frame in frames)
    assert counters.unknown == sum(not frame.verified for frame in frames)
    assert counters.lost == sum(source.lost for source in splitter.sources.values()) >= 0

    chopped = Splitter(dialect)
    again = [frame for part in _chop(data) for frame in chopped.feed(part)]
    assert again == frames
    assert asdict(chopped.counters) == asdict(counters)
    assert chopped.sources == splitter.sources

    place = 0
    for frame in frames:
        found = data.find(frame.data, place)
        assert found >= place
        place = found + len(frame.data)
        _check_frame(dialect, frame)


def _check_frame(dialect: Dialect, frame: Frame) -> None:
    assert parse_frame(frame.data, dialect) == frame
    read_event(frame)
    shown = describe(frame, dialect)
    assert msgspec.json.decode(msgspec.json.encode(shown)) == msgspec.to_builtins(shown)
    assert shown.verified == frame.verified
    if frame.verified:
        data = encode(dialect, shown.name, shown.fields, sysid=shown.sysid, compid=shown.compid, seq=shown.seq)
        back = describe(parse_frame(data, dialect), dialect)
        assert back.fields == {name: _as_encoded(value) for name, value in shown.fields.items()}


def _as_encoded(value: Any) -> Any:
    """Bytes that were no text come back as question marks."""
    return value.replace("\ufffd", "?") if isinstance(value, str) else value


def _chop(data: bytes) -> list[bytes]:
    rng, parts, place = random.Random(len(data) + sum(data)), list[bytes](), 0
    while place < len(data):
        size = rng.choice([1, 2, 3, 11, 21, 60, 300])
        parts.append(data[place : place + size])
        place += size
    return parts


def stream(rng: random.Random, data: bytes) -> bytes:
    """Another frame behind, of any message and with any payload; or a right checksum for what was spoilt, so that it
    is not always turned away at the door.
    """
    dialect = the_dialect()
    if rng.random() < 0.4:
        return _repaired(data)
    message = dialect.by_id[rng.choice(_numbers())]
    version = 1 if message.id < 256 and rng.random() < 0.3 else 2
    frame = Packer(dialect, rng.randint(0, 3), 1, version=version).pack(message.name)
    header = 6 if version == 1 else 10
    payload = rng.randbytes(frame[1] if version == 1 else rng.randint(0, message.max_length))
    made = _repaired(bytes([frame[0], len(payload)]) + frame[2:header] + payload + b"\0\0")
    return data[-2000:] + made


@functools.cache
def _numbers() -> list[int]:
    return sorted(the_dialect().by_id)


def _repaired(frame: bytes) -> bytes:
    header = {0xFD: 10, 0xFE: 6}.get(frame[0], 0) if frame else 0
    if not header or len(frame) < header:
        return frame
    end = header + frame[1]
    body = frame[1:end].ljust(end - 1, b"\0")
    msgid = int.from_bytes(body[6:9], "little") if header == 10 else body[4]
    message = the_dialect().by_id.get(msgid)
    crc_extra = message.crc_extra if message else 0
    signature = bytes(13) if header == 10 and body[1] == 1 else b""
    return frame[:1] + body + checksum(body, crc_extra).to_bytes(2, "little") + signature


def frames() -> list[bytes]:
    packer = Packer(the_dialect(), 1, 1)
    made = [packer.pack(name) for name in ("HEARTBEAT", "ATTITUDE", "STATUSTEXT", "PARAM_VALUE", "MISSION_ITEM_INT")]
    return [*made, b"".join(made), Packer(the_dialect(), 2, 1, version=1).pack("GPS_RAW_INT")]


# Signatures.


def signatures(data: bytes) -> None:
    """Both ends of a signed link: what is taken there was signed here, and unsigned frames only where they may."""
    dialect = the_dialect()
    ours, strict, open_ = (Signing(KEY, dialect), Signing(KEY, dialect), Signing(KEY, dialect, unsigned="accept"))
    for frame in Splitter(dialect).feed(data):
        strict.accepts(frame)
        assert frame.signed or open_.accepts(frame)
        if frame.verified and not frame.signed:
            try:
                signed = ours.sign(frame.data)
            except BadMessage:  # MAVLink 1
                continue
            back = parse_frame(signed, dialect)
            assert back.signed
            assert Signing(KEY, dialect).accepts(back)


def signed_frames() -> list[bytes]:
    signing = Signing(KEY, the_dialect())
    return [*frames(), *(signing.sign(frame) for frame in frames()[:4])]


# Texts, files, parameters, events.


def texts(data: bytes) -> None:
    """The bytes as STATUSTEXTs of 54 bytes each, two senders in turn."""
    joiner, packer = TextJoiner(), Packer(the_dialect(), 1, 1)
    blank = packer.pack("STATUSTEXT")
    for number, at in enumerate(range(0, min(len(data), 54 * 200), 54)):
        payload = data[at : at + 54]
        raw = bytes([0xFD, len(payload), 0, 0, 0, 1, 1 + number % 2]) + blank[7:10] + payload
        body = raw + checksum(raw[1:], the_dialect().by_id[MSGID].crc_extra).to_bytes(2, "little")
        for text in joiner.add(Frame(body, MSGID, True), number * 0.3):
            text.text.encode()
    for text in [*joiner.flush(1e3), *joiner.unfinished()]:
        text.text.encode()


def text_pieces() -> list[bytes]:
    def piece(words: bytes, number: int, seq: int) -> bytes:
        return struct.pack("<B50sHB", 3, words, number, seq)

    whole = piece(b"x" * 50, 7, 0) + piece(b"y" * 50, 7, 1) + piece("schön\0".encode(), 7, 2)
    return [piece(b"Arming denied", 0, 0), whole, piece(b"\xc3" * 50, 9, 255) + piece(b"\xa4", 9, 0)]


def ftp(data: bytes) -> None:
    packet = ftp_packets.unpack(data[: ftp_packets.PAYLOAD])
    assert len(packet.data) <= ftp_packets.MOST_DATA
    _ = packet.nak, packet.errno, packet.reason
    ftp_packets.pack(packet)
    for entry in ftp_packets.unpack_entries(data):
        if entry is not None:
            wire.encode(wire.FileEntry(name=entry.name, size=entry.size))


def ftp_payloads() -> list[bytes]:
    listed = b"Dlogs\0F1.BIN\t12345\0Skipped\0F" + b"n" * 40 + b"\t" + b"9" * 60 + b"\0"
    answers = [Packet(1, 0, 128, len(listed), 3, data=listed), Packet(2, 0, 129, 2, 4, data=b"\x02\x0d")]
    return [ftp_packets.pack(each) for each in (*answers, Packet(3, 1, 15, 239, offset=1 << 31))] + [listed]


def plan_file(data: bytes) -> None:
    """A plan's file as it comes, in packets; what holds all its items can be written again."""
    file = PlanFile("mission", the_dialect(), lambda done, of: None)
    for at in range(0, len(data), ftp_packets.MOST_DATA):
        file.put(at, data[at : at + ftp_packets.MOST_DATA])
    for raw in file.items():
        pack_item({**raw.fields(), "mission_type": 0}, the_dialect())


def plan_files() -> list[bytes]:
    item = pack_item(HOME.fields(), the_dialect())
    return [pack_header(0, count) + count * item for count in (0, 1, 20)]


def fields(data: bytes) -> None:
    """A frame made of its fields in JSON, as zenoh's own command line gives them; and anything shown."""
    for key in (TX, "zmav/demo/quad1/state", "@/x/router", ""):
        shown = zenoh_codec.decode(key, data)
        assert "\n" not in shown
        json.loads(shown)
    zenoh_codec.encode_text(TX, data.decode("utf-8", "replace"))


def field_objects() -> Sequence[bytes]:
    said = {"command": "MAV_CMD_NAV_TAKEOFF", "confirmation": 0, **{f"param{n}": float(n) for n in range(1, 8)}}
    return [json.dumps(said).encode(), json.dumps({**said, "command": 400, "param1": None}).encode()]


TARGETS = (
    Target("frames", pure(split), frames, 1500, stream),
    Target("signed_frames", pure(signatures), signed_frames, 1000, stream),
    Target("statustext", pure(texts), text_pieces),
    Target("ftp", pure(ftp), ftp_payloads, 3000),
    Target("plan_file", pure(plan_file), plan_files, 1000),
    Target("frame_fields", pure(fields), field_objects),
)
