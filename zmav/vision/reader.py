"""A camera's pictures from the key space, newest wins, with reports back to the camera of what comes of them.

async with Reader(z, "quad1", "down") as pictures:
    async for picture in pictures:
        image = picture.decode()
"""

from __future__ import annotations

import asyncio
import statistics
import time
import uuid
from collections.abc import AsyncIterator
from typing import Any, NamedTuple, TypeVar

import msgspec
import zenoh

from zmav import keys
from zmav.client import Answer, Client
from zmav.errors import VehicleError
from zmav.vision.assembler import Assembler, Whole
from zmav.vision.chunks import PICTURES
from zmav.vision.opencv import Image, decode
from zmav.waiting import on_loop
from zmav.wire import CameraInfo, FrameReport
from zmav.wire import decode as from_json

R = TypeVar("R", bound="Reader")
W = TypeVar("W", bound=msgspec.Struct)
REPORT_EVERY = 1.0 / (keys.FRAME_REPORT.rate_hz or 2.0)
"""s"""


class Picture(NamedTuple):
    """One picture, as it came."""

    jpeg: bytes
    t: float
    """UTC seconds at the middle of the exposure, by the camera's clock"""
    seq: int
    width: int
    height: int
    arrived: float
    """UTC seconds, by ours"""

    def decode(self) -> Image:
        """(height, width, 3) BGR; raises :class:`BadInput` for what is no JPEG, BadConfig without OpenCV."""
        return decode(self.jpeg)


class Reader:
    """Pictures of one camera, whole ones, in order; who is slow gets the newest. Lives on the event loop.

    ``name``: who reads, for the camera's list of readers. ``most_bytes``: B/s that our link has for pictures, where
    that is known; the camera then never sends more. ``fleet``: the vehicle's, where the client hears several. Raises
    :class:`~zmav.errors.BadKey` for what cannot be a name.
    """

    channel, reports, code = keys.FRAME, keys.FRAME_REPORT, PICTURES

    def __init__(
        self,
        z: Client,
        vehicle: str,
        camera: str = "down",
        *,
        name: str = "reader",
        most_bytes: float | None = None,
        fleet: str | None = None,
    ) -> None:
        self._z, self._vehicle, self._camera = z, keys.check_name(vehicle, "vehicle"), keys.check_name(camera, "camera")
        self._name = f"{keys.check_name(name, 'reader')}-{uuid.uuid4().hex[:8]}"
        self.most_bytes = most_bytes
        self.assembler = Assembler(self.code)
        """its counts say what became of chunks and pictures"""
        self.report: FrameReport | None = None
        """the last one sent"""
        self.skipped = 0
        """whole pictures that a newer one replaced before they were taken"""
        self._newest: Picture | None = None
        self._news = asyncio.Event()
        self._delays: list[float] = []
        self._wanted = z.fleet_name if fleet is None else fleet
        self._fleet = ""
        self._before = (0, 0, 0, 0.0)
        self._subscriber: zenoh.Subscriber[Any] | None = None
        self._publisher: zenoh.Publisher | None = None
        self._reporting: asyncio.Task[None] | None = None

    async def __aenter__(self: R) -> R:
        loop = asyncio.get_running_loop()
        key = self.channel.key(self._wanted, self._vehicle, camera=self._camera)
        self._before = (0, 0, 0, time.monotonic())
        self._subscriber = self._z.session.declare_subscriber(key, on_loop(loop, self._on_sample))
        self._reporting = loop.create_task(self._report())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._reporting is not None:
            self._reporting.cancel()
        held: tuple[Any, ...] = (self._subscriber, self._publisher)
        for each in held:
            if each is not None:
                each.undeclare()
        self._subscriber = self._publisher = None

    async def __aiter__(self) -> AsyncIterator[Picture]:
        while True:
            yield await self.get()

    async def get(self) -> Picture:
        """The newest picture that was not given yet; waits for one."""
        while self._newest is None:
            self._news.clear()
            await self._news.wait()
        picture, self._newest = self._newest, None
        return picture

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if not keys.hears(f"{keys.ROOT}/{self._wanted}", key):
            return
        self._fleet = key.split("/")[1]
        whole = self.assembler.add(sample.payload.to_bytes(), time.monotonic())
        if whole is not None:
            now = time.time()
            self._delays.append(now - whole.t)
            self._take(whole, now)

    def wants_key(self) -> bool:
        """Whether the next report asks for a key frame: pictures need none."""
        return False

    def _take(self, whole: Whole, now: float) -> None:
        self.skipped += self._newest is not None
        self._newest = Picture(whole.jpeg, whole.t, whole.seq, whole.width, whole.height, now)
        self._news.set()

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_EVERY)
            self.assembler.expire(time.monotonic())
            if self._fleet:  # else nothing has come yet: nobody to tell
                self._tell()

    def _tell(self) -> None:
        counts, now = self.assembler, time.monotonic()
        whole, torn, came, since = self._before
        self._before = (counts.whole, counts.torn, counts.bytes, now)
        self.report = FrameReport(
            t=time.time(),
            seq=counts.seq or 0,
            whole=counts.whole - whole,
            torn=counts.torn - torn,
            delay=statistics.median(self._delays) if self._delays else None,
            rate_bytes=(counts.bytes - came) / max(now - since, 1e-3),
            most_bytes=self.most_bytes,
            waits=self.wants_key(),
        )
        self._delays.clear()
        if self._publisher is None:
            key = self.reports.key(self._fleet, self._vehicle, camera=self._camera, reader=self._name)
            self._publisher = self._z.session.declare_publisher(key, **self.reports.publishing())
        self._z.put(self.reports, str(self._publisher.key_expr), self.report, publisher=self._publisher)


async def camera_info(z: Client, vehicle: str, camera: str, timeout: float = 2.0) -> CameraInfo:
    """A camera's lens, mount and rate. Raises :class:`VehicleError` where nobody answers, or what it answered."""
    text = f"{vehicle} has no camera {camera!r} that answers: 'zmav agent list' shows which there are, as camera-NAME"
    return await answered(z, keys.CAMERA, CameraInfo, vehicle, camera, timeout, text)


async def answered(
    z: Client, channel: keys.Channel, kind: type[W], vehicle: str, camera: str, timeout: float, otherwise: str
) -> W:
    """What a camera's program answers. Raises :class:`VehicleError`, ``otherwise``, where none does."""
    key = channel.key(z.fleet_name, vehicle, camera=camera)
    for answer in await z.ask(key, timeout=timeout, channel=channel, enough=lambda answer: True):
        if not isinstance(answer, Answer):
            raise answer
        return from_json(answer.payload, kind, f"camera {camera} of {vehicle}")
    raise VehicleError(otherwise, vehicle=vehicle, camera=camera)
