"""What the cameras' tests share: sources without a camera, a link that loses or is narrow, a running agent."""

from __future__ import annotations

import asyncio
import contextlib
import random
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import zenoh

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.capture import Shot
from agents.camera.settings import CameraSettings
from tests.cli.conftest import Process
from zmav import keys
from zmav.session import SessionSettings
from zmav.vision.opencv import Image, encode

if TYPE_CHECKING:
    from tests.conftest import Net


def scene(number: int, width: int = 320, height: int = 240) -> Image:
    """A picture with its number to tell it by, and texture enough to be worth its bytes."""
    rng = np.random.default_rng(number % 5)
    small = rng.integers(0, 255, (height // 20, width // 20, 3), dtype=np.uint8)
    image = np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    cv2.putText(image, str(number), (10, height // 2), cv2.FONT_HERSHEY_SIMPLEX, 2.0, (255, 255, 255), 4)
    return image


class Painted:
    """A source that paints pictures, as fast as it is told to."""

    words = "painted"

    def __init__(self, rate: float = 20.0, width: int = 320, height: int = 240, count: int | None = None) -> None:
        self._period, self._count = 1.0 / rate, count
        self._scenes = [scene(i, width, height) for i in range(5)]

    def check(self) -> None:
        """There is nothing that could be missing."""

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        number = 0
        while not closed.is_set() and number != self._count:
            yield Shot(number, time.time(), self._scenes[number % 5], None)
            number += 1
            closed.wait(self._period)


class Way:
    """Carries a camera's chunks from one router to another one, and the reports and questions back.

    ``lose`` says of each chunk whether it is lost; ``rate`` (B/s) is what goes through, ``queue`` (bytes) what may wait
    for it: more is dropped. Everything is carried on one event loop.
    """

    def __init__(
        self,
        near: zenoh.Session,
        far: zenoh.Session,
        lose: Callable[[], bool] = lambda: False,
        rate: float | None = None,
        queue: float = 4000.0,
    ) -> None:
        self.carried = self.lost = self.bytes = 0
        self._far, self._lose, self._rate, self._queue = far, lose, rate, queue
        self._loop = asyncio.get_running_loop()
        self._free = 0.0
        key = keys.FRAME.key("demo", "quad1", camera="down")
        self._out = far.declare_publisher(key, **keys.FRAME.publishing())
        report = keys.FRAME_REPORT.key("demo", "quad1", camera="down", reader="*")
        self._held = [
            near.declare_subscriber(key, self._come),
            far.declare_subscriber(report, lambda sample: near.put(sample.key_expr, sample.payload)),
        ]

    def _come(self, sample: zenoh.Sample) -> None:
        self._loop.call_soon_threadsafe(self._take, sample, time.monotonic())

    def _take(self, sample: zenoh.Sample, now: float) -> None:
        """``now``: when it came, however much later the loop has time for it."""
        data = sample.payload.to_bytes()
        if self._lose():
            self.lost += 1
            return
        if self._rate is None:
            self._carry(data)
            return
        self._free = max(self._free, now)
        if (self._free - now) * self._rate > self._queue:
            self.lost += 1
            return
        self._free += len(data) / self._rate
        self._loop.call_later(self._free - time.monotonic(), self._carry, data)

    def _carry(self, data: bytes) -> None:
        self.carried += 1
        self.bytes += len(data)
        with contextlib.suppress(zenoh.ZError):  # the test is over
            self._out.put(data)


def losing(share: float, seed: int = 1) -> Callable[[], bool]:
    """Loses that share of chunks, the same ones in every run."""
    rng = random.Random(seed)
    return lambda: rng.random() < share


Run = Callable[..., Any]
StartCamera = Callable[..., Process]


@pytest.fixture
async def run_camera(net: Net) -> AsyncIterator[Run]:
    """``await run_camera(endpoint, source, **settings)``: a running agent of quad1's camera ``down``."""
    async with contextlib.AsyncExitStack() as stack:

        async def run(endpoint: str, source: Any = None, lens: Any = 1.1, say: Any = None, **how: Any) -> CameraAgent:
            session = SessionSettings(connect=[endpoint])
            z = await stack.enter_async_context(zmav.open(settings=session))
            own = CameraSettings(vehicle="quad1", **how)
            agent = CameraAgent(z, own, source or Painted(), lens, say or (lambda line: None))
            return await stack.enter_async_context(agent)

        yield run


def write_pictures(folder: Path, count: int) -> Path:
    """Numbered pictures in a folder; gives it."""
    folder.mkdir()
    for number in range(count):
        (folder / f"{number:03d}.jpg").write_bytes(encode(scene(number), 60))
    return folder


@pytest.fixture
def start() -> Iterator[StartCamera]:
    """Start ``zmav camera ARGUMENTS`` of this tree, whatever is installed; what still runs at the end is killed."""
    started: list[Process] = []

    def run(*arguments: str) -> Process:
        code = "import sys; from zmav import cli; from agents.camera.cli import camera; cli.zmav = camera; cli.main()"
        started.append(Process(sys.executable, "-c", code, *arguments))
        return started[-1]

    yield run
    for process in started:
        if process.popen.poll() is None:
            process.popen.kill()
            process.wait()
