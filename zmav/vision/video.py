"""A camera's video from the key space: access units of H.264 (Annex B), as they were encoded; nothing here decodes
them.

async with VideoReader(z, "quad1", "down") as video:
    with video.units() as units:
        while True:
            unit = await units.get()
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput, BadMessage, missing_extra
from zmav.vision.assembler import Whole
from zmav.vision.chunks import MOST_JPEG, VIDEO
from zmav.vision.reader import Reader, answered
from zmav.wire import VideoInfo

START = b"\x00\x00\x01"
SLICE, KEY_SLICE, SPS, PPS, DELIMITER, FILLER = 1, 5, 7, 8, 9, 12
"""types of NAL units (ITU-T H.264, table 7-1)"""
KEY_FRAME = 1
"""bit of a unit's first byte on the wire"""
MOST_UNIT = MOST_JPEG - 1
MOST_NALS = 256
"""in one unit: a camera has one for each slice"""
MOST_WAITING, MOST_WAITING_BYTES = 60, 4_000_000
"""units that wait for who takes them: two seconds, as a rule"""
CLOCK_RATE = 90_000
"""Hz of time stamps in MPEG-TS and RTP"""
JUMP_S = 10.0
"""s between two units beyond which the camera's clock was set"""


def pyav() -> Any:
    """The module ``av`` (FFmpeg); raises :class:`BadConfig` where it is not installed."""
    try:
        import av
    except ImportError as e:
        raise missing_extra("video", "PyAV", "video") from e
    return av


class Unit(NamedTuple):
    """An access unit: one encoded picture. A key frame has its parameter sets with it."""

    data: bytes
    key: bool
    t: float
    """UTC seconds, by the camera's clock"""
    seq: int
    width: int
    height: int
    arrived: float
    """UTC seconds, by ours"""


def nal_units(data: bytes) -> list[bytes]:
    """The NAL units in a byte stream (ITU-T H.264, annex B). Raises :class:`BadMessage` where there are none, too many,
    or one that no camera sends.
    """
    if not data.startswith((START, b"\x00" + START)) or not data.count(START) <= MOST_NALS:
        raise BadMessage.wrong(
            "unit", len(data), f"1 to {MOST_NALS} NAL units", f"{len(data)} bytes are no access unit"
        )
    _, *more = data.split(START)
    found = [each[:-1] if each.endswith(b"\x00") else each for each in more[:-1]] + more[-1:]
    if not all(each and not each[0] & 0x80 and 1 <= each[0] & 0x1F <= 23 for each in found):
        raise BadMessage.wrong("unit", len(data), "NAL units of H.264", "an access unit holds what is no H.264")
    return found


def packed(data: bytes, key: bool) -> bytes:
    """What is cut into chunks. Raises :class:`BadInput` for what is too large."""
    if not 0 < len(data) <= MOST_UNIT:
        text = f"an access unit of {len(data)} bytes cannot be sent: have the camera encode with fewer bits"
        raise BadInput(text, field="unit", value=len(data), expected=f"1 to {MOST_UNIT} bytes")
    return bytes([KEY_FRAME if key else 0]) + data


def unpacked(whole: Whole, arrived: float) -> Unit:
    """Raises :class:`BadMessage` for what is no access unit: whoever sent it is not to be trusted further."""
    data, key = whole.jpeg[1:], bool(whole.jpeg[0] & KEY_FRAME)
    kinds = {each[0] & 0x1F for each in nal_units(data)}
    if key and not {KEY_SLICE, SPS, PPS} <= kinds:
        raise BadMessage.wrong(
            "unit", sorted(kinds), "parameter sets and a key frame", "a key frame lacks what it needs"
        )
    return Unit(data, key, whole.t, whole.seq, whole.width, whole.height, arrived)


class Packets:
    """Units as PyAV's packets, to be passed on. Their times only grow: where the camera's clock was set, or it was
    away, the next one is a thirtieth of a second later.
    """

    def __init__(self) -> None:
        self._av = pyav()
        self._zero: float | None = None
        self._pts = -1

    def of(self, unit: Unit) -> Any:
        self._zero = unit.t if self._zero is None else self._zero
        pts = round((unit.t - self._zero) * CLOCK_RATE)
        if not self._pts < pts <= self._pts + JUMP_S * CLOCK_RATE:
            pts = self._pts + CLOCK_RATE // 30
            self._zero = unit.t - pts / CLOCK_RATE
        packet: Any = self._av.Packet(unit.data)
        self._pts = packet.pts = packet.dts = pts
        packet.time_base, packet.is_keyframe = Fraction(1, CLOCK_RATE), unit.key
        return packet


class Units:
    """What waits for one who takes it: in order, from a key frame on. Of what is taken too slowly everything is
    dropped up to the next key frame.
    """

    def __init__(self) -> None:
        self.waits = True
        """for a key frame"""
        self.dropped = 0
        self._held: deque[Unit] = deque()
        self._bytes = 0
        self._ended = False
        self._news = asyncio.Event()

    def put(self, unit: Unit) -> None:
        if len(self._held) >= MOST_WAITING or self._bytes + len(unit.data) > MOST_WAITING_BYTES:
            self.lose()
        if self.waits and not unit.key:
            self.dropped += 1
            return
        self.waits = False
        self._held.append(unit)
        self._bytes += len(unit.data)
        self._news.set()

    def lose(self) -> None:
        """What waits, and what comes before the next key frame, is of no use any more."""
        self.dropped += len(self._held)
        self._held.clear()
        self._bytes, self.waits = 0, True

    async def get(self) -> Unit:
        """The next one; waits for it. Raises EOFError where no more will come."""
        while not self._held:
            if self._ended:
                raise EOFError("the video has ended")
            self._news.clear()
            await self._news.wait()
        unit = self._held.popleft()
        self._bytes -= len(unit.data)
        return unit

    def end(self) -> None:
        self._ended = True
        self._news.set()


class VideoReader(Reader):
    """Units of one camera, for any number who take them: :meth:`units`. Lives on the event loop; arguments as
    :class:`~zmav.vision.reader.Reader` has.
    """

    channel, reports, code = keys.VIDEO, keys.VIDEO_REPORT, VIDEO

    def __init__(self, z: Client, vehicle: str, camera: str = "down", **how: Any) -> None:
        super().__init__(z, vehicle, camera, **how)
        self.came = 0
        """units"""
        self.last: Unit | None = None
        self._takers: list[Units] = []
        self._asked = False

    @contextlib.contextmanager
    def units(self) -> Iterator[Units]:
        units = Units()
        self._takers.append(units)
        try:
            yield units
        finally:
            self._takers.remove(units)
            units.end()

    def ask(self) -> None:
        """Have the camera send a key frame soon, where it can."""
        self._asked = True

    def wants_key(self) -> bool:
        """Somebody here waits for one, or asked since the last report."""
        asked, self._asked = self._asked, False
        return asked or any(each.waits for each in self._takers)

    def _take(self, whole: Whole, now: float) -> None:
        try:
            unit = unpacked(whole, now)
        except BadMessage:
            self.assembler.bad += 1
            return
        gap = self.last is None or unit.seq != (self.last.seq + 1) % (1 << 32)
        self.last, self.came = unit, self.came + 1
        for each in tuple(self._takers):
            if gap and not unit.key:
                each.lose()
            each.put(unit)


async def video_info(z: Client, vehicle: str, camera: str, timeout: float = 2.0) -> VideoInfo:
    """What a camera's video is. Raises :class:`VehicleError` where nobody answers, or what it answered."""
    text = f"{vehicle} has no video {camera!r} that answers: 'zmav video ls' shows which there is"
    return await answered(z, keys.VIDEO_INFO, VideoInfo, vehicle, camera, timeout, text)
