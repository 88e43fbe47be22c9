"""Multipart pictures over HTTP (``multipart/x-mixed-replace``: RFC 2046, section 5.1), with the times they were taken.

The simulator's camera and most network cameras serve this. OpenCV would read it too, but loses the headers: X-Timestamp
(UTC seconds) is what a picture's place is worked out by.
"""

from __future__ import annotations

import http.client
import math
import threading
import time
import urllib.request
from collections import deque
from collections.abc import Iterator
from typing import IO, NamedTuple
from urllib.parse import urlsplit

import msgspec

from agents.camera.capture import Lost, Shot, without_password
from agents.camera.settings import Calibration
from zmav.errors import BadConfig
from zmav.vision.chunks import LATEST_T
from zmav.wire.base import Vector

PATIENCE = 10.0
"""s without a byte after which the server is taken for dead"""
LONGEST_LINE = 4096
MOST_LINES = 100
SIMULATED = "x-time"
"""a header of the simulator's: its clock falls behind ours where the machine is too slow for it"""
MOST_BYTES = 20_000_000
"""of one picture"""
LENS_PATIENCE, MOST_LENS = 3.0, 100_000
"""s for what the simulator says of its camera, and bytes of it"""
LATE, EARLY = 0.02, -0.005
"""s from exposure to arrival, at the least, beyond which the two clocks are not one"""
USUAL = 0.008
"""s that it takes at the least where they are not: to be rendered or read out, and handed over"""
WINDOW = 5.0
"""s of arrivals that are looked at"""


class MjpegSource:
    """``http://host:port/NAME.mjpeg``; ``delay``: s from shutter to arrival where the server gives no X-Timestamp."""

    def __init__(self, url: str, delay: float = 0.0) -> None:
        self.words = without_password(url)
        self._url, self._delay = url, delay

    def check(self) -> None:
        try:
            parts = urlsplit(self._url)
            whole = parts.scheme == "http" and bool(parts.hostname) and (parts.port or 80) > 0
        except ValueError:
            whole = False
        if not whole:
            text = f"{self._url!r} is no address of pictures: expected http://HOST:PORT/NAME.mjpeg"
            raise BadConfig(text, field="source", value=self._url, expected="http://HOST:PORT/NAME.mjpeg")

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        parts = urlsplit(self._url)
        connection = http.client.HTTPConnection(parts.hostname or "", parts.port or 80, timeout=PATIENCE)
        try:
            connection.request("GET", (parts.path or "/") + (f"?{parts.query}" if parts.query else ""))
            answer = connection.getresponse()
            kind = answer.headers.get_content_type()
            if answer.status != 200 or not kind.startswith("multipart/"):
                raise Lost(f"the server answers {answer.status} {answer.reason} ({kind}), and no multipart pictures")
            count, clock = 0, TheirClock()
            while not closed.is_set():
                headers, jpeg = part(answer)
                now = time.time()
                told = _taken(headers)
                if told is None:
                    told = now - self._delay
                elif SIMULATED in headers:
                    told = clock.ours(told, now)
                yield Shot(count, told, None, jpeg)
                count += 1
        except (http.client.HTTPException, OSError) as e:
            raise Lost(f"the stream broke off: {str(e) or type(e).__name__}") from e
        finally:
            connection.close()


def part(stream: IO[bytes] | http.client.HTTPResponse) -> tuple[dict[str, str], bytes]:
    """The next picture with its headers (lower case); raises :class:`Lost` where the stream ends or is none."""
    for _ in range(MOST_LINES):
        line = _line(stream)
        if line.startswith(b"--"):
            break
        if line.strip():
            raise Lost("the stream holds something else than parts")
    else:
        raise Lost("the stream holds nothing")
    headers: dict[str, str] = {}
    for _ in range(MOST_LINES):
        line = _line(stream).strip()
        if not line:
            break
        name, _, value = line.decode("latin-1").partition(":")
        headers[name.strip().lower()] = value.strip()
    length = headers.get("content-length", "")
    if not length.isascii() or not length.isdigit() or not 0 < int(length) <= MOST_BYTES:
        raise Lost(f"a picture's Content-Length is {length!r}: expected 1 to {MOST_BYTES}")
    jpeg = stream.read(int(length))
    if len(jpeg) < int(length):
        raise Lost("the stream ended within a picture")
    return headers, jpeg


def _line(stream: IO[bytes] | http.client.HTTPResponse) -> bytes:
    line = stream.readline(LONGEST_LINE)
    if not line.endswith(b"\n"):
        raise Lost("the stream ended" if len(line) < LONGEST_LINE else "the stream holds a line without an end")
    return line


def _taken(headers: dict[str, str]) -> float | None:
    try:
        t = float(headers["x-timestamp"])
    except (KeyError, ValueError):
        return None
    return t if 0.0 < t < LATEST_T else None  # in milliseconds no reader would take it


class TheirClock:
    """Times of one source by a clock that is not ours, as of a simulator that falls behind: set right where they cannot
    be of ours, by the least delay of the last few seconds, as network clocks do it (Cristian 1989): nothing comes
    before it was sent, and now and then something comes at once.
    """

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()

    def ours(self, t: float, arrived: float) -> float:
        """``t`` (UTC s by their clock) of what ``arrived`` (UTC s by ours), by our clock."""
        delays = self._delays
        delays.append((arrived, arrived - t))
        while delays[0][0] < arrived - WINDOW or delays[0][0] > arrived:
            delays.popleft()
        least = min(delay for _, delay in delays)
        return t if EARLY <= least <= LATE else t + least - USUAL


class SimulatedLens(NamedTuple):
    """What the simulator's camera says of its lens and mount: ``/NAME.json`` beside its pictures."""

    calibration: Calibration
    mount: Vector
    """rad"""
    offset: Vector
    """m"""
    gimbal: bool


class _Told(msgspec.Struct):
    width: int
    height: int
    camera_matrix: tuple[Vector, Vector, Vector]
    mount_deg: Vector
    offset_m: Vector
    gimbal: bool


def numbers(url: str) -> SimulatedLens | None:
    """Of the camera whose pictures are at ``http://host:port/NAME.mjpeg``; None where it is no simulator's."""
    parts = urlsplit(url)
    if not parts.path.endswith(".mjpeg"):
        return None
    where = parts._replace(path=parts.path.removesuffix(".mjpeg") + ".json", query="").geturl()
    try:
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(where, timeout=LENS_PATIENCE) as answer:
            told: _Told = msgspec.json.decode(answer.read(MOST_LENS), type=_Told)
        (fx, _, cx), (_, fy, cy), _ = told.camera_matrix
        lens = {"focal": (fx, fy), "center": (cx, cy)}
        calibration = msgspec.convert({"width": told.width, "height": told.height, **lens}, Calibration)
    except (OSError, ValueError, http.client.HTTPException):  # msgspec's errors are ValueErrors, urllib's OSErrors
        return None
    roll, pitch, yaw = (math.radians(angle) for angle in told.mount_deg)
    return SimulatedLens(calibration, (roll, pitch, yaw), told.offset_m, told.gimbal)
