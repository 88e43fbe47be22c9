"""What sends of a camera have in common: a session of their own, readers' reports, chunks spread over time."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, TypeVar

import msgspec
import zenoh

from agents.camera.budget import Budget
from agents.camera.capture import Capture
from agents.camera.settings import CameraSettings
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadInput
from zmav.process import until_stopped
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.trust.gate import anybody
from zmav.waiting import cancelled, in_thread, on_loop, until_any, within

S = TypeVar("S", bound="Sender")
SHORTEST_SLEEP = 0.002
"""s of pacing that are saved up: shorter sleeps cost more than they smooth"""


class Sender(ABC):
    """``async with``: sends on ``channel`` while somebody listens, answers on ``about``, and hears ``reports``.

    What is sent goes by a session of its own, so that it does not queue before anything else. ``say`` takes a line for
    people, from any thread.
    """

    channel: ClassVar[keys.Channel]
    about: ClassVar[keys.Channel]
    reports: ClassVar[keys.Channel]
    reported: ClassVar[int] = 1
    """pictures between two reports, at most"""
    agent: ClassVar[str]
    """what stands before the camera's name in the name of its status"""

    def __init__(self, z: Client, settings: CameraSettings, say: Callable[[str], None] = lambda line: None) -> None:
        self.settings = settings.check()
        self.budget = Budget(settings, self.reported)
        self.bad = 0
        """reports that could not be read"""
        self.failed = 0
        """what could not be sent: no picture, or too large"""
        self.sent = 0
        """pictures"""
        self.ended = asyncio.Event()
        """the source has come to its end, and its last picture is sent"""
        self._z, self._say = z, say
        self.sender = random.SystemRandom().getrandbits(32)
        self._wanted, self._news = asyncio.Event(), asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._held: list[Any] = []
        self._questions: Questions | None = None
        self._session: zenoh.Session | None = None
        self._capture: Capture | None = None
        self.wrong = ""
        """why the last picture could not be sent; empty: it was"""
        self._pace = 0.0

    async def __aenter__(self: S) -> S:
        loop, own, fleet = asyncio.get_running_loop(), self.settings, self._z.fleet_name
        key = {"fleet": keys.check_name(fleet, "fleet"), "vehicle": own.vehicle, "camera": own.camera}
        self._session = await self._z.another_session()
        publisher = self._session.declare_publisher(self.channel.key(**key), **self.channel.publishing())
        on_match: Any = on_loop(loop, self._on_match)
        about, reports = self.about.key(**key), self.reports.key(**key, reader="*")
        self._held = [
            publisher.declare_matching_listener(on_match),
            publisher,
            self._z.session.declare_subscriber(reports, on_loop(loop, self._on_report)),
        ]
        self._questions = Questions(self._z.session, Answers(None, None), anybody)
        self._questions.declare(about, lambda query: self._answer(about))
        self._on_match(publisher.matching_status)
        self._capture = self._opened(loop)
        self._tasks = [loop.create_task(self._send_all(publisher)), loop.create_task(self._look_after())]
        return self

    async def __aexit__(self, *exc: object) -> None:
        try:
            await cancelled(*self._tasks)
        finally:  # also where we are told to hurry: with its session open the process would never end
            await self._close()

    async def _close(self) -> None:
        try:
            if self._questions is not None:
                self._questions.close()
            for each in self._held:
                with contextlib.suppress(zenoh.ZError):  # the session has gone
                    each.undeclare()
            if self._capture is not None:
                await in_thread(self._capture.close)
        finally:
            if self._session is not None:
                await in_thread(self._session.close)

    @abstractmethod
    def _opened(self, loop: asyncio.AbstractEventLoop) -> Capture:
        """The source, running."""

    @abstractmethod
    async def _send_all(self, publisher: zenoh.Publisher) -> None:
        """Until the source's end."""

    @abstractmethod
    def info(self) -> msgspec.Struct:
        """What the camera is asked for."""

    @abstractmethod
    def words(self) -> str:
        """What is sent now, for people."""

    @property
    def watched(self) -> bool:
        """Whether anybody reads the pictures; else none is sent."""
        return self._wanted.is_set()

    @property
    def capture(self) -> Capture:
        if self._capture is None:
            raise RuntimeError("the camera's agent does not run: use 'async with'")
        return self._capture

    async def serve(self) -> None:
        """Return at the source's end, or when we are told to stop; raises what ended the sending otherwise."""
        await until_any(until_stopped(), self._sent())

    async def _sent(self) -> None:
        await asyncio.shield(self._tasks[0])  # whose end is :meth:`__aexit__`'s affair

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
        self._heard(report)

    def _heard(self, report: wire.FrameReport) -> None:  # noqa: B027  (of pictures the budget is all)
        """A reader's word, which the budget has taken already."""

    def _answer(self, key: str) -> Iterator[Reply]:
        yield Reply(key, wire.encode(self.info()))

    # Chunks.

    async def _put(self, publisher: zenoh.Publisher, chunks: Sequence[bytes], t: float, needs: float) -> None:
        """All chunks of a picture of ``t``, spread over the time that the budget gives them; ``needs``: bytes of them
        without which a reader cannot have it.
        """
        rate, total = self.budget.bytes, sum(map(len, chunks))
        self._pace = max(self._pace, time.monotonic())
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
            text = lost or self.wrong or f"{self.words()}, {len(self.budget.links)} readers"
            with contextlib.suppress(zenoh.ZError):
                self._z.say_status(f"{self.agent}-{own.camera}", state, text, vehicle=own.vehicle, sent=self.sent)
            with contextlib.suppress(asyncio.TimeoutError):
                await within(1.0, self.ended.wait())
            if self.ended.is_set():
                await asyncio.sleep(1.0)
