"""EXIF in a JPEG, as much as mapping programs ask for: when and where it was taken (EXIF 2.32, TIFF 6.0)."""

from __future__ import annotations

import struct
from datetime import datetime, timezone

from zmav import wire

BYTE, ASCII, LONG, RATIONAL = 1, 2, 4, 5
HEADER = 8
"""bytes of TIFF before the first directory"""
Entry = tuple[int, int, int, bytes]
"""tag, type, count, value"""


def with_exif(jpeg: bytes, t: float, place: wire.GlobalPosition | None) -> bytes:
    """A JPEG with its time (UTC s) and place behind its first marker."""
    block = b"Exif\0\0" + tiff(t, place)
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg[2:]


def tiff(t: float, place: wire.GlobalPosition | None) -> bytes:
    """The block: the directory of the picture, and those of EXIF and GPS behind it."""
    taken = datetime.fromtimestamp(t, timezone.utc)
    when = taken.strftime("%Y:%m:%d %H:%M:%S")
    exif = [_text(0x9003, when), _text(0x9011, "+00:00"), _text(0x9291, f"{taken.microsecond // 1000:03d}")]
    gps = [] if place is None else _gps(taken, place)
    top = [_text(0x010F, "zmav"), _text(0x0132, when)]
    at = HEADER + _size([*top, _long(0x8769, 0), *([_long(0x8825, 0)] if gps else [])])
    top.append(_long(0x8769, at))
    if gps:
        top.append(_long(0x8825, at + _size(exif)))
    parts = [_directory(top, HEADER), _directory(exif, at)]
    if gps:
        parts.append(_directory(gps, at + _size(exif)))
    return struct.pack(">2sHL", b"MM", 42, HEADER) + b"".join(parts)


def _gps(taken: datetime, place: wire.GlobalPosition) -> list[Entry]:
    clock = ((taken.hour, 1), (taken.minute, 1), (taken.second * 1000 + taken.microsecond // 1000, 1000))
    return [
        (0x0000, BYTE, 4, bytes((2, 3, 0, 0))),
        _text(0x0001, "N" if place.lat_deg >= 0.0 else "S"),
        _rationals(0x0002, *_sexagesimal(place.lat_deg)),
        _text(0x0003, "E" if place.lon_deg >= 0.0 else "W"),
        _rationals(0x0004, *_sexagesimal(place.lon_deg)),
        (0x0005, BYTE, 1, bytes((int(place.alt_amsl < 0.0),))),
        _rationals(0x0006, (round(abs(place.alt_amsl) * 1000), 1000)),
        _rationals(0x0007, *clock),
        _text(0x001D, taken.strftime("%Y:%m:%d")),
    ]


def _sexagesimal(degrees: float) -> tuple[tuple[int, int], ...]:
    """Degrees, minutes, and seconds to a hundred thousandth: a third of a millimetre."""
    whole = round(abs(degrees) * 3600 * 100_000)
    minutes, seconds = divmod(whole, 60 * 100_000)
    return (minutes // 60, 1), (minutes % 60, 1), (seconds, 100_000)


def _text(tag: int, text: str) -> Entry:
    value = text.encode("ascii") + b"\0"
    return tag, ASCII, len(value), value


def _long(tag: int, value: int) -> Entry:
    return tag, LONG, 1, struct.pack(">L", value)


def _rationals(tag: int, *pairs: tuple[int, int]) -> Entry:
    return tag, RATIONAL, len(pairs), b"".join(struct.pack(">LL", *pair) for pair in pairs)


def _size(entries: list[Entry]) -> int:
    """Bytes of a directory with the values that do not fit into it."""
    return 6 + sum(12 + (_even(len(value)) if len(value) > 4 else 0) for *_, value in entries)


def _even(length: int) -> int:
    return length + length % 2


def _directory(entries: list[Entry], at: int) -> bytes:
    """A directory that begins at that byte of the block."""
    head, tail = struct.pack(">H", len(entries)), b""
    values = at + 6 + 12 * len(entries)
    for tag, kind, count, value in sorted(entries):
        if len(value) > 4:
            where = struct.pack(">L", values + len(tail))
            tail += value.ljust(_even(len(value)), b"\0")
        else:
            where = value.ljust(4, b"\0")
        head += struct.pack(">HHL", tag, kind, count) + where
    return head + struct.pack(">L", 0) + tail
