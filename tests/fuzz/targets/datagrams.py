"""Small binary messages between hosts: pictures in chunks, probes, the bearer's headers."""

from __future__ import annotations

import struct

from mesh.bearer import header
from mesh.quality import meter
from tests.fuzz.engine import Target, pure
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


TARGETS = (
    Target("chunks", pure(chunks), pictures),
    Target("probe", pure(probe), probes, 3000),
    Target("bearer", pure(bearer), bearers, 3000),
)
