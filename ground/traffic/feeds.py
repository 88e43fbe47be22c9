"""Feeds of ADS-B as dump1090, readsb and their kin serve them: SBS (BaseStation, text) and Beast (raw frames)."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from ground.program import Connecting
from zmav.errors import BadUrl
from zmav.traffic import Sighting, Tracks
from zmav.waiting import within
from zmav.wire import AltitudeFrom, Vector

PORTS = {"sbs": 30003, "beast": 30005}
EXPECTED = "sbs:HOST, sbs:HOST:30003, beast:HOST or beast:HOST:30005"
FOOT, KNOT, FOOT_A_MINUTE = 0.3048, 1852.0 / 3600.0, 0.3048 / 60.0
LONGEST_LINE = 512
PIECE, MOST_RATE = 16_384, 400_000.0
"""bytes that are read at once, and B/s of a feed: some 4,000 messages, more than one antenna hears"""
CONNECT_S, SILENCE_S = 5.0, 60.0
"""s to connect, and s of nothing at all after which a feed is connected to again: some routers forget it silently"""
FORGET_S = 60.0
"""s of an aircraft's silence after which the decoder forgets it"""


class Feed(msgspec.Struct, frozen=True):
    kind: str
    host: str
    port: int

    @property
    def words(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"


def parse_feed(text: str) -> Feed:
    """Raises :class:`BadUrl` for what is no feed."""
    found = re.fullmatch(r"(sbs|beast):(?://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+)(?::(\d{1,5}))?/?", text)
    port = int(found[3] or PORTS[found[1]]) if found else 0
    if found is None or not 0 < port < 65536:
        raise BadUrl(f"no feed {text!r}", field="feed", value=text, expected=EXPECTED)
    return Feed(found[1], found[2].strip("[]"), port)


def velocity_of(speed: float, track_deg: float, climb: float) -> Vector:
    """m/s, degrees clockwise from north, m/s upwards -> m/s NED."""
    angle = math.radians(track_deg)
    return speed * math.cos(angle), speed * math.sin(angle), -climb


def _number(text: str) -> float | None:
    """None: it is empty, or no number that can be."""
    with contextlib.suppress(ValueError):
        if text and math.isfinite(found := float(text)):
            return found
    return None


class SbsReader:
    """Lines of BaseStation. ``skipped`` counts those that are none."""

    def __init__(self) -> None:
        self._rest = b""
        self._over = False
        """the line that is being read is too long already"""
        self.skipped = 0

    def feed(self, data: bytes, tracks: Tracks, now: float) -> None:
        *lines, rest = (self._rest + data).split(b"\n")
        for line in lines:
            if self._over or len(line) > LONGEST_LINE:
                self._over = False
                self.skipped += 1
            elif line.strip():
                self._line(line.decode("ascii", "replace"), tracks, now)
        self._over = self._over or len(rest) > LONGEST_LINE
        self._rest = b"" if self._over else rest

    def _line(self, line: str, tracks: Tracks, now: float) -> None:
        f = line.strip().split(",")
        if f[0] in ("STA", "AIR", "ID", "SEL", "CLK"):
            return
        if f[0] != "MSG" or not 18 <= len(f) <= 32 or not re.fullmatch(r"~?[0-9A-Fa-f]{6}", f[4]):
            self.skipped += 1
            return
        f += [""] * (22 - len(f))
        alt, speed, track, lat, lon, climb = map(_number, f[11:17])
        sighting = Sighting(
            int(f[4].lstrip("~"), 16),
            place=None if lat is None or lon is None else (lat, lon),
            alt=None if alt is None else alt * FOOT,
            velocity=None
            if speed is None or track is None
            else velocity_of(speed * KNOT, track, (climb or 0.0) * FOOT_A_MINUTE),
            callsign=f[10] or None,
            ground={"-1": True, "1": True, "0": False}.get(f[21].strip()),
            squawk=f[17].strip() or None,
        )
        tracks.hear(sighting, now)


FRAME = re.compile(
    rb"\x1a(?:1((?:[^\x1a]|\x1a\x1a){9})|2((?:[^\x1a]|\x1a\x1a){14})|3((?:[^\x1a]|\x1a\x1a){21}))", re.DOTALL
)
LONGEST_FRAME = 2 + 2 * 21
HEAD = 7
"""bytes of a frame before the message: the receiver's clock and the signal's strength"""


class BeastReader:
    """Frames of Beast, decoded by pyModeS. ``skipped`` counts messages whose checksum is wrong."""

    def __init__(self) -> None:
        from pyModeS import PipeDecoder

        self._rest = b""
        self.skipped = 0
        self._decoder = PipeDecoder(eviction_ttl=FORGET_S)

    def feed(self, data: bytes, tracks: Tracks, now: float) -> None:
        data, end = self._rest + data, 0
        for found in FRAME.finditer(data):
            end = found.end()
            if found[3] is not None:
                self._message(found[3].replace(b"\x1a\x1a", b"\x1a")[HEAD:], tracks, now)
        self._rest = data[end:][-LONGEST_FRAME:]

    def _message(self, message: bytes, tracks: Tracks, now: float) -> None:
        """Of extended squitters alone; before anything is kept of one, there is room for its aircraft."""
        if message[0] >> 3 not in (17, 18):
            return
        icao = int.from_bytes(message[1:4], "big")
        if not tracks.room(icao, now):
            return
        try:
            m: Mapping[str, Any] = self._decoder.decode(message.hex(), timestamp=now)
        except Exception:  # whatever it stumbles over is no aircraft's
            m = {}
        if not m.get("crc_valid"):
            self.skipped += 1
            return
        lat, lon, alt = m.get("latitude"), m.get("longitude"), m.get("altitude")
        speed, track = m.get("groundspeed"), m.get("track")
        climb = (m.get("vertical_rate") or 0) * FOOT_A_MINUTE
        alt_from: AltitudeFrom = "geometric" if m.get("typecode") in (20, 21, 22) else "pressure"
        sighting = Sighting(
            icao,
            place=None if lat is None or lon is None else (lat, lon),
            alt=None if alt is None else alt * FOOT,
            alt_from=alt_from,
            velocity=None if speed is None or track is None else velocity_of(speed * KNOT, track, climb),
            callsign=m.get("callsign"),
            ground={"0,6": True, "0,5": False}.get(m.get("bds") or ""),
            squawk=m.get("squawk"),
        )
        tracks.hear(sighting, now)


class FeedSource(Connecting):
    def __init__(
        self, feed: Feed, tracks: Tracks, told: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(feed.words, told)
        self.feed, self._tracks, self._clock = feed, tracks, clock
        self.heard = 0.0
        """monotonic s of the last bytes; 0: none yet"""
        self.skipped = 0

    def why(self, error: Exception) -> str:
        if isinstance(error, asyncio.TimeoutError):
            return f"nothing came for {SILENCE_S:.0f} s" if self.state == "up" else "no answer"
        if isinstance(error, (OSError, UnicodeError)):
            return getattr(error, "strerror", None) or str(error)
        raise error

    async def serve(self) -> str:
        connecting = asyncio.open_connection(self.feed.host, self.feed.port, limit=PIECE)
        reader, writer = await within(CONNECT_S, connecting)
        self.turn("up")
        readers = SbsReader() if self.feed.kind == "sbs" else BeastReader()
        before = self.skipped
        try:
            while data := await within(SILENCE_S, reader.read(PIECE)):
                self.heard = self._clock()
                readers.feed(data, self._tracks, self.heard)
                self.skipped = before + readers.skipped
                await asyncio.sleep(len(data) / MOST_RATE)
        finally:
            writer.close()
        return "it closed the connection"
