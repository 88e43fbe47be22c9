"""Small binary messages between hosts: pictures in chunks, probes, the bearer's headers."""

from __future__ import annotations

import contextlib
import math
import struct

from ground.rtk.ntrip import Chunks, Ended
from ground.rtk.ublox import UbxCutter
from ground.traffic.feeds import BeastReader, SbsReader
from mesh.bearer import header
from mesh.quality import meter
from tests.fuzz.engine import Target, pure
from tests.rtcm import base_at, message
from zmav import corrections, traffic, wire
from zmav.formats.rtcm3 import Cutter, Message, crc24q
from zmav.mavlink.rtcm import Joiner
from zmav.sim.sbs import line
from zmav.traffic import Tracks
from zmav.vision.assembler import Assembler
from zmav.vision.chunks import split

PIECE = struct.Struct(">H")
"""before each chunk of an input its length"""


def chunks(data: bytes) -> None:
    """Several chunks, one after the other, as they come."""
    assembler, at, now = Assembler(), 0, 1000.0
    while at + PIECE.size <= len(data) and now < 1100.0:
        (size,) = PIECE.unpack_from(data, at)
        at += PIECE.size + size
        now += 0.05
        assembler.add(data[at - size : at], now)
        assembler.expire(now)


def pictures() -> list[bytes]:
    jpeg = bytes(range(256)) * 12
    found = []
    for spare in (0, 3):
        made = split(jpeg, sender=7, seq=1, t=1.7e9, size=(640, 480), spare=spare)
        made += split(jpeg, sender=7, seq=2, t=1.7e9, size=(640, 480), spare=spare)[1:]
        found.append(b"".join(PIECE.pack(len(each)) + each for each in made))
    return found


def probe(data: bytes) -> None:
    found = meter.unpack(data)
    assert found.pack()[:12] == data[:12]
    found.rtt(meter.clock(1e6))


def probes() -> list[bytes]:
    made = meter.Stamp(b"s" * meter.SOURCE, 0.5, 2, 3, 4, held=5, loss=0.01)
    return [made.pack()]


def bearer(data: bytes) -> None:
    header.unpack(memoryview(data))


def bearers() -> list[bytes]:
    return [header.pack_data(7, 3, True, b"payload"), header.pack_probe(7, 9, 1, echo=False)]


def batches(data: bytes) -> None:
    found = corrections.unpack(data)
    assert found.pack() == data
    for each in found.messages:
        _ = each.number, each.station, each.place, each.observes


def packed() -> list[bytes]:
    messages = tuple(Message(each) for each in (base_at(), message(1077, size=300), message(1230, size=20)))
    return [corrections.Batch(3, 7, 1, 2, 9, "gs", messages).pack()]


def bases(data: bytes) -> None:
    """What comes from a base or a caster in pieces, and from a station in fragments: a message behind it is found."""
    last, cutter, joiner, chunks, ubx = message(1087), Cutter(), Joiner(), Chunks(), UbxCutter()
    step = 1 + len(data) % 97
    with contextlib.suppress(Ended):
        for at in range(0, len(data), step):
            piece = data[at : at + step]
            assert all(crc24q(found.data) == 0 for found in cutter.feed(piece))
            ubx.feed(piece)
            cutter.feed(joiner.add(piece[0], len(piece), piece))
            chunks.feed(piece)
    found = cutter.feed(bytes(1100) + last)  # whatever length the last of it claimed
    assert found
    assert found[-1].data == last


def feeds(data: bytes) -> None:
    """What comes from a receiver of ADS-B in pieces: a line behind it is found, and no more is kept than may be."""
    sbs, beast, tracks, now = SbsReader(), BeastReader(), Tracks(most=50), 0.0
    step = 1 + len(data) % 97
    for at in range(0, len(data), step):
        now += 0.3
        sbs.feed(data[at : at + step], tracks, now)
        beast.feed(data[at : at + step], tracks, now)
    assert len(tracks) <= 50
    report = wire.Traffic(t=1.0, source="gs", instance=1)
    tracks.tell(report, [(50.0, 8.0)], 1e6, now)
    assert traffic.read(wire.encode(report)) == report
    sbs.feed(b"\r\n", tracks, now)
    found = Tracks()
    sbs.feed(line(0x3C4B12, 50.0, 8.0, 100.0).encode() + b"\n", found, now)
    assert len(found) == 1


def receivers() -> list[bytes]:
    lines = "\r\n".join(line(0x3C4B12, 50.0 + i * 1e-4, 8.0, 900.0, (50.0, 3.0, 1.0), "DEABC") for i in range(3))
    frames = ("8D40621D58C382D690C8AC2863A7", "8D40621D58C386435CC412692AD6", "8D485020994409940838175B284F")
    beast = b"".join(b"\x1a3\x00\x11\x22\x33\x44\x55\x7f" + bytes.fromhex(frame) for frame in frames)
    return [lines.encode() + b"\r\n", 4 * beast]


def reports(data: bytes) -> None:
    report = traffic.read(data)
    picture = traffic.AirPicture()
    picture.hear(report, 100.0, report.t)
    here = wire.GlobalPosition(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0, alt_rel=10.0)
    for seen in picture.aircraft(101.0):
        found = traffic.approach(seen, here, (1.0, 2.0, 3.0))
        assert all(math.isfinite(number) for number in found if number is not None)
        traffic.Alarm().of(seen, found, True)


def told() -> list[bytes]:
    aircraft = wire.Aircraft(icao="3c4b12", lat_deg=50.0, lon_deg=8.0, age=1.0, alt=900.0, velocity=(50.0, 3.0, 1.0))
    known = wire.Traffic(t=1e9, source="gs", instance=1, serves="sbs:a:1", qnh=1020.0, aircraft=[aircraft, aircraft])
    return [wire.encode(known)]


def streams() -> list[bytes]:
    ubx = bytes.fromhex("b56205010200068a98c1")
    return [b"$GNGGA*00\r\n" + base_at() + ubx + message(1074) + b"5\r\nhello\r\n", message(1077, size=1023)]


TARGETS = (
    Target("corrections", pure(batches), packed, 3000),
    Target("bases", pure(bases), streams, 2000),
    Target("feeds", pure(feeds), receivers, 2000),
    Target("traffic", pure(reports), told, 3000),
    Target("chunks", pure(chunks), pictures),
    Target("probe", pure(probe), probes, 3000),
    Target("bearer", pure(bearer), bearers, 3000),
)
