"""A receiver of ADS-B that makes its aircraft up: a feed of BaseStation lines, for demos and tests of traffic."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from zmav import geo, wire

Fault = Literal["", "stops", "jumps", "lies", "garbage"]
"""stops: nothing more comes, and the connection stays; jumps: each third position is 20 km aside; lies: a thousand
aircraft a second that are not there; garbage: lines that are none, beside those that are
"""
FAULTS = tuple(fault for fault in get_args(Fault) if fault)
FOOT, KNOT = 0.3048, 1852.0 / 3600.0
PERIOD_S = 0.5
JUMP_DEG = 0.2
LIES = 500
"""aircraft that are not there, a period"""


@dataclass
class MadeUp:
    """Straight from ``start`` (NED m about the source's origin) with ``velocity``; or around the origin in a circle."""

    icao: int
    callsign: str
    start: wire.Vector
    velocity: wire.Vector
    circle: bool = False

    def at(self, t: float) -> tuple[wire.Vector, wire.Vector]:
        """Place and velocity, s after the beginning."""
        if not self.circle:
            (n, e, d), (vn, ve, vd) = self.start, self.velocity
            return (n + vn * t, e + ve * t, d + vd * t), self.velocity
        radius, speed = math.hypot(*self.start[:2]), math.hypot(*self.velocity[:2])
        angle = math.atan2(self.start[1], self.start[0]) + speed / radius * t
        place = radius * math.cos(angle), radius * math.sin(angle), self.start[2]
        return place, (-speed * math.sin(angle), speed * math.cos(angle), 0.0)


def circling(count: int) -> list[MadeUp]:
    """So many, each on a circle of its own, 1 km and more from the origin."""
    return [
        MadeUp(0x3C4B00 + i, f"SIM{i + 1:03d}", (1000.0 + 400.0 * i, 0.0, -80.0 - 40.0 * i), (0.0, 50.0, 0.0), True)
        for i in range(count)
    ]


class SbsSource:
    """``async with SbsSource(origin, aircraft) as source: source.port``; ``fault`` can be set while it runs."""

    def __init__(
        self, origin: wire.Origin, aircraft: Sequence[MadeUp], host: str = "127.0.0.1", port: int = 0, fault: Fault = ""
    ) -> None:
        self._origin, self.aircraft, self._host, self.port, self.fault = origin, list(aircraft), host, port, fault
        self._writers: set[asyncio.StreamWriter] = set()
        self._invented = itertools.count(0x100000)
        self.began = time.monotonic()

    async def __aenter__(self) -> SbsSource:
        self._server = await asyncio.start_server(self._serve, self._host, self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        self.began = time.monotonic()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.drop()

    def drop(self) -> None:
        """Close all connections; who wants to may connect again."""
        for writer in self._writers:
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            for turn in itertools.count():
                if self.fault != "stops":
                    writer.write("".join(f"{line}\r\n" for line in self._lines(turn)).encode())
                    await writer.drain()
                await asyncio.sleep(PERIOD_S)
        except (OSError, asyncio.CancelledError):
            return
        finally:
            self._writers.discard(writer)
            writer.close()

    def _lines(self, turn: int) -> Iterator[str]:
        t = time.monotonic() - self.began
        for each in self.aircraft:
            place, velocity = each.at(t)
            lat, lon, alt = geo.to_global(self._origin, place)
            if self.fault == "jumps" and turn % 3 == 2:
                lat += JUMP_DEG
            yield line(each.icao, lat, lon, alt, velocity, each.callsign)
        if self.fault == "lies":
            for _ in range(LIES):
                yield line(next(self._invented) % 0x400000, self._origin.lat_deg, self._origin.lon_deg, 100.0)
        if self.fault == "garbage":
            yield "MSG,3,,,,,,,,,,NaN,inf,,nan,1e999,,,,,,"
            yield "MSG,3,,,3C4B12,,,,,,,NaN,inf,,nan,1e999,,,,,,"
            yield "\x00\xff," * 300


def line(
    icao: int, lat: float, lon: float, alt: float, velocity: wire.Vector = (0.0, 0.0, 0.0), callsign: str = ""
) -> str:
    """Everything in one line, as many feeds send it; ``alt`` in m."""
    north, east, down = velocity
    speed, track = math.hypot(north, east) / KNOT, math.degrees(math.atan2(east, north)) % 360.0
    return (
        f"MSG,3,1,1,{icao:06X},1,,,,,{callsign},{alt / FOOT:.0f},{speed:.1f},{track:.1f},{lat:.6f},{lon:.6f},"
        f"{-down / FOOT * 60.0:.0f},,,,,0"
    )
