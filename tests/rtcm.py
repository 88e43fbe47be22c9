"""Messages of RTCM 3 as bases send them: where the base is, and observations as far as their head goes."""

from __future__ import annotations

from zmav import geo
from zmav.formats.rtcm3 import frame

HOME = (-35.363262, 149.165237, 584.0)
STATION = 1234


def message(number: int, *, size: int = 60, station: int = STATION, seed: int = 0) -> bytes:
    """One of that number with so many bytes inside: what follows the station's id is made up from the seed."""
    head = (number << 12 | station).to_bytes(3, "big")
    body = bytes((seed * 7 + i * 13 + number) % 256 for i in range(size - len(head)))
    return frame(head + body)


def base_at(
    lat_deg: float = HOME[0], lon_deg: float = HOME[1], height: float = HOME[2], station: int = STATION
) -> bytes:
    """Message 1005."""
    x, y, z = (round(part * 1e4) & (1 << 38) - 1 for part in geo.to_ecef(lat_deg, lon_deg, height))
    bits = 1005
    for value, width in ((station, 12), (0, 6), (0b1110, 4), (x, 38), (0, 2), (y, 38), (0, 2), (z, 38)):
        bits = bits << width | value
    return frame(bits.to_bytes(19, "big"))


def satellites(number: int = 1074, *, t_ms: int = 0, count: int = 8, station: int = STATION) -> bytes:
    """A well-formed MSM 4 of so many satellites with one signal each, whose observations are zeros."""
    fields = [(number, 12), (station, 12), (t_ms, 30), (0, 1), (0, 3), (0, 7), (0, 2), (0, 2), (0, 1), (0, 3)]
    fields += [((1 << count) - 1 << 64 - count, 64), (1 << 30, 32), ((1 << count) - 1, count)]
    fields += [(80, 8)] * count + [(500, 10)] * count
    for width in (15, 22, 4, 1, 6):
        fields += [(0, width)] * count
    bits = total = 0
    for value, width in fields:
        bits, total = bits << width | value, total + width
    spare = -total % 8
    return frame((bits << spare).to_bytes((total + spare) // 8, "big"))
