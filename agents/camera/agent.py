"""A camera's agent: newest picture in, chunks out, never faster than the tightest reader's link takes."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

from agents.camera.budget import Budget
from agents.camera.capture import Capture, Shot, Source
from agents.camera.quality_steps import QualityStep, QualitySteps
from agents.camera.settings import Calibration, CameraSettings, cropped
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadInput
from zmav.services.link.port import on_loop
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.session import SessionSettings, open_in_thread
from zmav.trust.gate import anybody
from zmav.vision.chunks import MOST_JPEG, count_of, split
from zmav.vision.opencv import decode, encode, opencv
from zmav.vision.parity import needed
from zmav.waiting import in_thread, within
from zmav.wire import CameraInfo

EARLY = 0.2
"""of a period that a picture may come before its time, so that sources as fast as we send are not waited for twice"""
SHORTEST_SLEEP = 0.002
"""s of pacing that are saved up: shorter sleeps cost more than they smooth"""
WORST_QUALITY = 20
LARGER = 1.5
"""times what is expected that a source's own JPEG may have to be sent as it came"""


class CameraAgent:
    """``async with CameraAgent(z, settings, source, lens, bulk)``: lives on the event loop until it is left.

    ``lens``: the calibration, or the horizontal field of view in rad of one that does not distort. ``bulk``: how the
    session for the pictures is opened, so that they do not queue before anything else. ``say`` takes a line for people,
    from any thread. Raises what :meth:`CameraSettings.check` and the source's ``check`` do.
    """

    def __init__(
        self,
        z: Client,
        settings: CameraSettings,
        source: Source,
        lens: Calibration | float,
        bulk: SessionSettings,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        opencv()
        source.check()
        self.settings = settings.check()
        self.budget = Budget(settings)
        self.quality = QualitySteps(settings)
        self.size = (0, 0)
        """width and height of the pictures sent now; 0: none was"""
        self.bad = 0
        """reports that could not be read"""
        self.failed = 0
        """pictures that could not be sent: no JPEG, or too large"""
        self.sent = 0
        """pictures"""
        self.ended = asyncio.Event()
        """the source has come to its end, and its last picture is sent"""
        self._z, self._source, self._lens, self._bulk, self._say = z, source, lens, bulk, say
        self._sender = random.SystemRandom().getrandbits(32)
        self._wanted, self._news = asyncio.Event(), asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._held: list[Any] = []
        self._questions: Questions | None = None
        self._session: zenoh.Session | None = None
        self._capture: Capture | None = None
        self._full_size = settings.size
        self.zoom = 1.0
        """times closer than the lens is: the middle of the picture is sent"""
        self._wrong = ""
        """why the last picture could not be sent; empty: it was"""
        self._pace = 0.0

    async def __aenter__(self) -> CameraAgent:
        loop, own, fleet = asyncio.get_running_loop(), self.settings, self._z.fleet_name
        key = {"fleet": keys.check_name(fleet, "fleet"), "vehicle": own.vehicle, "camera": own.camera}
        self._session = await open_in_thread(self._bulk)
        publisher = self._session.declare_publisher(keys.FRAME.key(**key), **keys.FRAME.publishing())
        on_match: Any = on_loop(loop, self._on_match)
        info, reports = keys.CAMERA.key(**key), keys.FRAME_REPORT.key(**key, reader="*")
        self._held = [
            publisher.declare_matching_listener(on_match),
            publisher,
            self._z.session.declare_subscriber(reports, on_loop(loop, self._on_report)),
        ]
        self._questions = Questions(self._z.session, Answers(None, None), anybody)
        self._questions.declare(info, lambda query: self._answer(info))
        self._on_match(publisher.matching_status)
        self._capture = Capture(self._source, on_loop(loop, self._news.set), self._say)
        self._tasks = [loop.create_task(self._send_all(publisher)), loop.create_task(self._look_after())]
        return self

    async def __aexit__(self, *exc: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._questions is not None:
            self._questions.close()
        for each in self._held:
            with contextlib.suppress(zenoh.ZError):  # the session has gone
                each.undeclare()
        if self._capture is not None:
            await in_thread(self._capture.close)
        if self._session is not None:
            await in_thread(self._session.close)

    @property
    def watched(self) -> bool:
        """Whether anybody reads the pictures; else none is sent."""
        return self._wanted.is_set()

    @property
    def capture(self) -> Capture:
        if self._capture is None:
            raise RuntimeError("the camera's agent does not run: use 'async with CameraAgent(...)'")
        return self._capture

    async def finished(self) -> None:
        """Return at the source's end; raises what ended the sending otherwise."""
        await asyncio.shield(self._tasks[0])

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

    # What others say.

    def _on_match(self, status: Any) -> None:
        if status.matching:
            self._wanted.set()
        else:
            self._wanted.clear()

    def _on_report(self, sample: zenoh.Sample) -> None:
        reader = str(sample.key_expr).rpartition("/")[2]
        try:
            report = wire.decode(sample.payload.to_bytes(), wire.FrameReport, f"report of {reader}")
        except BadInput:
            self.bad += 1
            return
        self.budget.report(reader, report, time.monotonic())

    def _answer(self, key: str) -> Iterator[Reply]:
        yield Reply(key, wire.encode(self.info()))

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
                self._wrong = ""
            except BadInput as e:
                self.failed, self._wrong = self.failed + 1, str(e)

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
        image = decode(shot.jpeg) if shot.image is None and shot.jpeg is not None else shot.image
        assert image is not None
        image, zoomed = cropped(image, self.zoom), self.zoom > 1.0
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
        """All chunks of a picture, spread over the time that the budget gives them. Raises :class:`BadInput`."""
        spare = needed(count_of(len(jpeg)), self.budget.loss)
        chunks = split(jpeg, sender=self._sender, seq=self.sent, t=t, size=self.size, spare=spare)
        rate, total = self.budget.bytes, sum(map(len, chunks))
        self._pace = max(self._pace, time.monotonic())
        needs = min(len(jpeg) / (1.0 - self.budget.loss), total)
        self.budget.sent.add(self.sent, total, time.time() - t + needs / rate, time.monotonic())
        for chunk in chunks:
            wait = self._pace - time.monotonic()
            if wait > SHORTEST_SLEEP:
                await asyncio.sleep(wait)
            with contextlib.suppress(zenoh.ZError):  # the session has gone; anyone who opened it knows
                publisher.put(chunk)
            self._pace += len(chunk) / rate
        self.sent = (self.sent + 1) % (1 << 32)

    # What it says of itself.

    async def _look_after(self) -> None:
        """Say once a second how it goes; also while no picture comes."""
        while True:
            lost, own = self.capture.lost, self.settings
            state = "lost" if lost else "ended" if self.ended.is_set() else "sending" if self.watched else "waiting"
            (width, height), rate = self.size, self.budget.bytes / 1e3
            sends = f"{width}x{height}, {self.quality.step.words}, {rate:.0f} kB/s, {len(self.budget.links)} readers"
            text = lost or self._wrong or sends
            with contextlib.suppress(zenoh.ZError):
                self._z.say_status(f"camera-{own.camera}", state, text, vehicle=own.vehicle, sent=self.sent)
            with contextlib.suppress(asyncio.TimeoutError):
                await within(1.0, self.ended.wait())
            if self.ended.is_set():
                await asyncio.sleep(1.0)
