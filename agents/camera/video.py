"""A camera's video: what it encodes, into the key space as it is, while somebody watches; never a queue that grows.

Where a camera can be told, it is to encode with as many bits as the tightest reader's link takes; else the richest of
its streams is sent that fits, and at the end key frames only.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from agents.camera.capture import Capture
from agents.camera.rungs import Rungs
from agents.camera.sender import Sender
from agents.camera.settings import CameraSettings
from agents.camera.streams import BITS, Encoded, Encoding, Stream
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadConfig, BadInput
from zmav.vision.chunks import VIDEO, count_of, split
from zmav.vision.erasure import needed
from zmav.vision.video import packed
from zmav.waiting import in_thread, on_loop

MOST_BEHIND = 1.0
"""s of sending that may wait: beyond it all is dropped up to the next key frame"""
AIM_S = 1.0
"""s between two looks at whether stream and link go together"""
USED = 0.85
"""of the budget that an encoder is asked to fill"""
SEARCH_S = 20.0
"""s after the first reader came, in which what its link takes may still be searched for"""
ASK_S = 1.0
"""s between two key frames that the camera is asked for"""
MEASURE_S = 4.0
"""s over which a stream's rate is measured"""


class Feed(Capture):
    """Runs a stream; gives each unit to ``take``, in the stream's thread."""

    def __init__(self, stream: Stream, take: Callable[[Encoded], None], *said: Any) -> None:
        self._pass = take
        super().__init__(stream, *said)  # type: ignore[arg-type]  # units in the place of pictures

    def _keep(self, shot: Any) -> None:
        if not self._closed.is_set():  # else a stream that was left long ago would come between another's units
            self._pass(shot)


class Rate:
    """Of a stream lately: units and bytes a second."""

    def __init__(self) -> None:
        self._times: deque[tuple[float, int]] = deque(maxlen=1000)

    def add(self, length: int, now: float) -> None:
        self._times.append((now, length))

    def of(self, now: float) -> tuple[float, float]:
        """From any thread."""
        times = [each for each in tuple(self._times) if each[0] >= now - MEASURE_S]
        over = now - times[0][0] if len(times) > 1 else 0.0
        return (len(times) / over, sum(size for _, size in times) / over) if over > 0.5 else (0.0, 0.0)


class VideoAgent(Sender):
    """``async with VideoAgent(z, settings, streams)``; ``streams``: of one view, the richest first. Raises what
    their ``check`` does, and :class:`BadConfig` where there is none.
    """

    channel, about, reports, agent = keys.VIDEO, keys.VIDEO_INFO, keys.VIDEO_REPORT, "video"
    reported = 60

    def __init__(
        self,
        z: Client,
        settings: CameraSettings,
        streams: Sequence[Stream],
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        if not streams:
            raise BadConfig("a camera without a stream", field="streams", value=[], expected="one or more")
        for stream in streams:
            stream.check()
        super().__init__(z, settings, say)
        self.rungs = Rungs(len(streams), time.monotonic())
        self.dropped = 0
        """units that were not sent while somebody watched"""
        self.size = (0, 0)
        self._streams = streams
        self._rate, self._overhead = Rate(), 1.2
        self._waiting: deque[Encoded] = deque()
        self.waiting_bytes = 0
        self._broken = True
        """what is not a key frame is of no use until one was sent"""
        self._asked = self._looked = self._since = 0.0
        self._aimed = False

    @property
    def stream(self) -> Stream:
        return self._streams[self.rungs.at]

    @property
    def needs(self) -> float:
        """B/s of the whole stream, with what mends it; of one that can be told, what it needs at least."""
        found = self._rate.of(time.monotonic())[1] * self._overhead
        return min(found, BITS[0] / 8.0 * self._overhead) if self._aimed else found

    def info(self) -> wire.VideoInfo:
        rate_hz, rate_bytes = self._rate.of(time.monotonic())
        return wire.VideoInfo(
            t=time.time(),
            camera=self.settings.camera,
            width=self.size[0],
            height=self.size[1],
            rate_hz=rate_hz,
            rate_bytes=rate_bytes,
            stream=self.rungs.at + 1,
            streams=len(self._streams),
            key_frames_only=self.rungs.key_only,
            lost=self._capture.lost if self._capture else "",
            source=self.stream.words,
        )

    def words(self) -> str:
        (width, height), (hz, size) = self.size, self._rate.of(time.monotonic())
        which = f", stream {self.rungs.at + 1} of {len(self._streams)}" if len(self._streams) > 1 else ""
        link = f"the link takes {self.budget.bytes / 1e3:.0f} kB/s"
        only = f", key frames only: the stream needs {self.needs / 1e3:.0f} kB/s" if self.rungs.key_only else ""
        return f"{width}x{height}, {hz:.0f} Hz, {size / 1e3:.0f} kB/s{which}, {link}{only}"

    def _opened(self, loop: asyncio.AbstractEventLoop) -> Capture:
        return Feed(self.stream, on_loop(loop, self._take), on_loop(loop, self._news.set), self._say)

    def _on_match(self, status: Any) -> None:
        super()._on_match(status)
        for stream in self._streams:
            if isinstance(stream, Encoding):
                stream.wanted = self.watched
        self._broken = True
        if self.watched:
            self._since = time.monotonic()
            self._ask()

    def _heard(self, report: wire.FrameReport) -> None:
        if report.waits:
            self._ask()

    def _ask(self) -> None:
        now = time.monotonic()
        if now - self._asked >= ASK_S:
            self._asked = now
            self.stream.want_key()

    def _take(self, unit: Encoded) -> None:
        """A unit of the camera: it waits to be sent, or is dropped with all up to the next key frame."""
        self.size = unit.width, unit.height
        self._rate.add(len(unit.data), time.monotonic())
        if not self.watched:
            self._broken = True
            return
        late = self._waiting and self.waiting_bytes * self._overhead / self.budget.bytes > MOST_BEHIND
        if late or (not unit.key and (self._broken or self.rungs.key_only)):
            self._broken = True
            self.dropped += 1
            return
        self._broken = False
        self._waiting.append(unit)
        self.waiting_bytes += len(unit.data)
        self._news.set()

    async def _send_all(self, publisher: zenoh.Publisher) -> None:
        while True:
            self._news.clear()
            await self._fit()
            while self._waiting:
                unit = self._waiting.popleft()
                self.waiting_bytes -= len(unit.data)
                try:
                    await self._send(publisher, unit)
                    self.wrong = ""
                except BadInput as e:
                    self.failed, self.wrong = self.failed + 1, str(e)
                    self._drop()  # what waits behind it was encoded after it
                await self._fit()
            if self.capture.ended:
                self.ended.set()
                return
            await self._news.wait()

    async def _send(self, publisher: zenoh.Publisher, unit: Encoded) -> None:
        """Raises :class:`BadInput`."""
        data = packed(unit.data, unit.key)
        spare = needed(count_of(len(data)), round(100.0 * self.budget.loss))
        size = (unit.width or 1, unit.height or 1)
        chunks = split(data, sender=self.sender, seq=self.sent, t=unit.t, size=size, spare=spare, code=VIDEO)
        total = sum(map(len, chunks))
        self._overhead += 0.05 * (total / len(data) - self._overhead)
        seq = self.sent
        await self._put(publisher, chunks, unit.t, min(len(data) / (1.0 - self.budget.loss), total))
        self.budget.sent.took(seq, time.time() - unit.t)

    async def _fit(self) -> None:
        """Once in a while: have the camera encode what the link takes, or take another of its streams."""
        now = time.monotonic()
        if now - self._looked < AIM_S or not self.watched:
            return
        self._looked = now
        self.budget.expire(now)
        self._aimed = self.stream.aim(8.0 * USED * self.budget.bytes / self._overhead)
        before = self.rungs.at
        if not self.budget.searched and now - self._since < SEARCH_S:
            return  # the budget grows fast yet: too little of it is no news
        if self.rungs.choose(self.budget.bytes, self.needs, now):
            self._drop()
            self._ask()
            if self.rungs.at != before:
                await self._change()

    def _drop(self) -> None:
        """What waits, and all up to the next key frame."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self.waiting_bytes, self._broken = 0, True

    async def _change(self) -> None:
        """To another stream: nothing of the old one comes after something of the new one."""
        await in_thread(self.capture.close)
        await asyncio.sleep(0.0)  # what it had put on the loop by then
        self._drop()
        self._rate = Rate()
        self._capture = self._opened(asyncio.get_running_loop())
        self._say(f"{self.settings.camera}: stream {self.rungs.at + 1} of {len(self._streams)}, {self.stream.words}")
