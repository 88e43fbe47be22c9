"""A camera's agent: newest picture in, chunks out, never faster than the tightest reader's link takes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import zenoh

from agents.camera.capture import Capture, Shot, Source
from agents.camera.quality_steps import QualityStep, QualitySteps
from agents.camera.sender import Sender
from agents.camera.settings import Calibration, CameraSettings, cropped
from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput
from zmav.vision.chunks import MOST_JPEG, count_of, split
from zmav.vision.opencv import encode, opencv
from zmav.vision.parity import needed
from zmav.waiting import on_loop
from zmav.wire import CameraInfo

EARLY = 0.2
"""of a period that a picture may come before its time, so that sources as fast as we send are not waited for twice"""
WORST_QUALITY = 20
LARGER = 1.5
"""times what is expected that a source's own JPEG may have to be sent as it came"""


class CameraAgent(Sender):
    """``async with CameraAgent(z, settings, source, lens)``: lives on the event loop until it is left.

    ``lens``: the calibration, or the horizontal field of view in rad of one that does not distort. ``say`` takes a line
    for people, from any thread. Raises what :meth:`CameraSettings.check` and the source's ``check`` do.
    """

    channel, about, reports, agent = keys.FRAME, keys.CAMERA, keys.FRAME_REPORT, "camera"

    def __init__(
        self,
        z: Client,
        settings: CameraSettings,
        source: Source,
        lens: Calibration | float,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        opencv()
        source.check()
        super().__init__(z, settings, say)
        self.quality = QualitySteps(settings)
        self.size = (0, 0)
        """width and height of the pictures sent now; 0: none was"""
        self._source, self._lens = source, lens
        self._full_size = settings.size
        self.zoom = 1.0
        """times closer than the lens is: the middle of the picture is sent"""

    def _opened(self, loop: asyncio.AbstractEventLoop) -> Capture:
        return Capture(self._source, on_loop(loop, self._news.set), self._say)

    def info(self) -> CameraInfo:
        """What the camera is asked for; raises :class:`BadConfig` where the calibration does not fit its pictures."""
        size = self.size if all(self.size) else self._full_size
        step, lens = self.quality.step, self._lens
        fitting = lens.scaled(*size) if isinstance(lens, Calibration) else Calibration.by_angle(lens, *size)
        fitting = fitting.zoomed(self.zoom)
        own = self.settings
        return CameraInfo(
            t=time.time(),
            camera=own.camera,
            width=fitting.width,
            height=fitting.height,
            focal=fitting.focal,
            center=fitting.center,
            distortion=fitting.distortion,
            mount=own.mount,
            offset=own.offset,
            gimbal=own.gimbal,
            rate_hz=step.rate,
            quality=step.quality,
            source=self._source.words,
        )

    # Pictures.

    async def _send_all(self, publisher: zenoh.Publisher) -> None:
        last, due = -1, time.monotonic()
        while True:
            await self._wanted.wait()
            shot = await self._newest(last)
            if shot is None:
                self.ended.set()
                return
            self.budget.expire(time.monotonic())
            step = self.quality.choose(self.budget.bytes, self.budget.loss)
            wait = due - EARLY / step.rate - time.monotonic()
            if wait > 0.0:
                await asyncio.sleep(wait)
                shot = self.capture.latest or shot
            last, now = shot.seq, time.monotonic()
            due = max(due, now - 1.0 / step.rate) + 1.0 / step.rate
            try:
                jpeg, size = await asyncio.to_thread(self._made, shot, step)
                self.size = size
                self.quality.learn(step, len(jpeg))
                await self._send(publisher, jpeg, shot.t)
                self.wrong = ""
            except BadInput as e:
                self.failed, self.wrong = self.failed + 1, str(e)

    async def _newest(self, last: int) -> Shot | None:
        """The latest picture once it is later than ``last``; None at the source's end."""
        while True:
            self._news.clear()
            shot = self.capture.latest
            if shot is not None and shot.seq > last:
                return shot
            if self.capture.ended:
                return None
            await self._news.wait()

    def _made(self, shot: Shot, step: QualityStep) -> tuple[bytes, tuple[int, int]]:
        """The JPEG and its size; in a thread. Raises :class:`BadInput` for what cannot be sent."""
        cv2 = opencv()
        image, zoomed = cropped(shot.decoded(), self.zoom), self.zoom > 1.0
        height, width = image.shape[:2]
        scale = min(1.0, self.settings.size[0] / width, self.settings.size[1] / height)
        self._full_size = full = (max(round(width * scale), 1), max(round(height * scale), 1))
        size = (max(full[0] // 2, 1), max(full[1] // 2, 1)) if step.half else full
        most = min(LARGER * self.quality.expected(step), MOST_JPEG)
        as_is = size == (width, height) and step.quality == self.settings.quality
        if shot.jpeg is not None and not zoomed and as_is and len(shot.jpeg) <= most:
            return shot.jpeg, size  # made again it would only be worse
        if size != (width, height):
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        jpeg, quality = encode(image, step.quality), step.quality
        while len(jpeg) > MOST_JPEG and quality > WORST_QUALITY:
            quality = max(quality - 15, WORST_QUALITY)
            jpeg = encode(image, quality)
        return jpeg, size

    async def _send(self, publisher: zenoh.Publisher, jpeg: bytes, t: float) -> None:
        """Raises :class:`BadInput`."""
        spare = needed(count_of(len(jpeg)), self.budget.loss)
        chunks = split(jpeg, sender=self.sender, seq=self.sent, t=t, size=self.size, spare=spare)
        total = sum(map(len, chunks))
        await self._put(publisher, chunks, t, min(len(jpeg) / (1.0 - self.budget.loss), total))

    def words(self) -> str:
        (width, height), rate = self.size, self.budget.bytes / 1e3
        return f"{width}x{height}, {self.quality.step.words}, {rate:.0f} kB/s"
