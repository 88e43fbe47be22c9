"""What comes of a camera's pictures over bad links: ours beside whole JPEGs that are put as they come.

    python tests/bench/camera_link.py [SECONDS]

Both send the same 640x480 pictures at 10 Hz through two routers; between them stands a link that loses 0, 10 or 30 % of
the packets at random (seeded), or carries 40 or 100 kB/s and keeps 30 ms (radio) or 2 s (modem) of what is too much.
The plain way puts each JPEG whole on a reliable lane, which nothing is lost on: what the link loses is sent again after
60 ms, and what comes after it waits for it; what is too much waits, however long. The link takes no root: it is this
process's own queue. SECONDS (20) are measured after as many of getting used to the link. Printed are the pictures that
came, of those the source took, and the delay from shutter to reader.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import statistics
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
import zenoh

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.capture import Shot
from agents.camera.settings import CameraSettings
from zmav import keys
from zmav.session import SessionSettings, open_session
from zmav.vision.chunks import MOST_CHUNK
from zmav.vision.opencv import Image, encode
from zmav.vision.reader import Reader

RATE, QUALITY = 10.0, 70
AGAIN_S = 0.06
"""until a reliable lane notices a loss and has sent once more"""
KEY = keys.FRAME.key("demo", "quad1", camera="down")
PLAIN = keys.FRAME.key("demo", "quad1", camera="plain")


class Link(NamedTuple):
    name: str
    loss: float = 0.0
    rate: float | None = None
    """B/s"""
    queue: float = 0.0
    """s of it that may wait"""


LINKS = (
    Link("no loss"),
    Link("10 % lost", 0.1),
    Link("30 % lost", 0.3),
    Link("100 kB/s, 30 ms queue", rate=100e3, queue=0.03),
    Link("40 kB/s, 30 ms queue", rate=40e3, queue=0.03),
    Link("40 kB/s, 2 s queue", rate=40e3, queue=2.0),
    Link("100 kB/s, 30 ms, 10 % lost", 0.1, 100e3, 0.03),
)


def scenes() -> list[Image]:
    """Ground as a camera sees it: about 40 kB each."""
    rng = np.random.default_rng(2)
    found = []
    for _ in range(8):
        image = cv2.resize(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
        grain = rng.normal(0.0, 7.0, image.shape)
        found.append(np.clip(image + grain, 0, 255).astype(np.uint8))
    return found


class Painted:
    words = "painted"

    def __init__(self) -> None:
        self._scenes = scenes()

    def check(self) -> None:
        """Nothing can be missing."""

    def shots(self, closed: threading.Event) -> Iterator[Shot]:
        number = 0
        while not closed.is_set():
            yield Shot(number, time.time(), self._scenes[number % len(self._scenes)], None)
            number += 1
            closed.wait(1.0 / RATE)


class Pipe:
    """The link: packets in, packets out later or never. ``reliable``: lost ones come later, and hold up the rest."""

    def __init__(self, link: Link, out: Callable[[bytes], None], reliable: bool) -> None:
        self._link, self._out, self._reliable = link, out, reliable
        self._loop, self._rng = asyncio.get_running_loop(), random.Random(5)
        self._free = self._held = 0.0

    def take(self, packets: list[bytes]) -> None:
        """One message; it is given whole at its last packet, or not at all where one was dropped."""
        now, dropped, last = time.monotonic(), False, 0.0
        for packet in packets:
            self._free = max(self._free, now)
            if self._link.rate is not None:
                if self._free - now > self._link.queue and not self._reliable:
                    dropped = True
                    continue
                self._free += len(packet) / self._link.rate
            arrival = self._free
            while self._rng.random() < self._link.loss:
                if not self._reliable:
                    dropped = True
                    break
                arrival += AGAIN_S
            last = max(last, arrival)
        if dropped:
            return
        if self._reliable:
            last = self._held = max(self._held, last)
        self._loop.call_later(max(0.0, last - now), self._out, b"".join(packets))


class Result(NamedTuple):
    whole: float
    """share of the pictures that the source took"""
    torn: float
    """share of those that were sent"""
    median: float
    late: float
    """s: 95th percentile"""
    rate: float
    """B/s that came"""


def result(delays: list[float], taken: int, torn: int, size: int, seconds: float) -> Result:
    share = len(delays) / max(taken, 1)
    ordered = sorted(delays) or [float("nan")]
    return Result(
        min(share, 1.0),
        torn / max(torn + len(delays), 1),
        statistics.median(ordered),
        ordered[int(0.95 * (len(ordered) - 1))],
        size / seconds,
    )


def routers(held: contextlib.ExitStack) -> list[tuple[zenoh.Session, str]]:
    found = []
    for _ in range(2):
        how = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        session = held.enter_context(open_session(how))
        (reply,) = session.get(f"@/{session.info.zid()}/router")
        assert reply.ok is not None
        found.append((session, json.loads(reply.ok.payload.to_bytes())["locators"][0]))
    return found


async def ours(link: Link, seconds: float) -> Result:
    """The agent and the reader."""
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as held:
        (near, here), (far, there) = routers(held)
        publisher = far.declare_publisher(KEY, **keys.FRAME.publishing())

        def put(data: bytes) -> None:
            with contextlib.suppress(zenoh.ZError):  # the run is over, and this was late
                publisher.put(data)

        pipe = Pipe(link, put, reliable=False)
        near.declare_subscriber(KEY, lambda s: loop.call_soon_threadsafe(pipe.take, [s.payload.to_bytes()]))
        report = keys.FRAME_REPORT.key("demo", "quad1", camera="down", reader="*")
        far.declare_subscriber(report, lambda s: near.put(s.key_expr, s.payload))
        own, session = CameraSettings(vehicle="quad1", rate=RATE, quality=QUALITY), SessionSettings(connect=[here])
        async with (
            zmav.open(settings=session) as z,
            zmav.open(settings=SessionSettings(connect=[there])) as ground,
            CameraAgent(z, own, Painted(), 1.1) as agent,
            Reader(ground, "quad1") as reader,
        ):
            delays: list[float] = []
            size = 0

            async def take() -> None:
                nonlocal size
                async for picture in reader:
                    delays.append(picture.arrived - picture.t)
                    size += len(picture.jpeg)

            taking = asyncio.create_task(take())
            await asyncio.sleep(seconds)
            delays.clear()
            size, before, torn = 0, agent.capture.count, reader.assembler.torn
            await asyncio.sleep(seconds)
            taking.cancel()
            print(f"    ours ended at {agent.quality.step.words}, {agent.budget.bytes / 1e3:.0f} kB/s", file=sys.stderr)
            return result(delays, agent.capture.count - before, reader.assembler.torn - torn, size, seconds)


async def plain(link: Link, seconds: float) -> Result:
    """Whole JPEGs, put reliable, nothing adapted."""
    loop = asyncio.get_running_loop()
    with contextlib.ExitStack() as held:
        (near, here), (far, there) = routers(held)
        publisher = far.declare_publisher(PLAIN)

        def put(data: bytes) -> None:
            with contextlib.suppress(zenoh.ZError):  # the run is over, and this was late
                publisher.put(data)

        pipe = Pipe(link, put, reliable=True)

        def cut(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            packets = [data[i : i + MOST_CHUNK] for i in range(0, len(data), MOST_CHUNK)]
            loop.call_soon_threadsafe(pipe.take, packets)

        near.declare_subscriber(PLAIN, cut)
        source, reader = (held.enter_context(open_session(SessionSettings(connect=[e]))) for e in (here, there))
        came: list[tuple[float, int]] = []

        def take(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            came.append((time.time() - struct.unpack(">d", data[:8])[0], len(data)))

        reader.declare_subscriber(PLAIN, take)
        out, closed, taken = source.declare_publisher(PLAIN), threading.Event(), 0
        end, used = time.monotonic() + 2.0 * seconds, time.monotonic() + seconds
        shots = Painted().shots(closed)
        while time.monotonic() < end:
            shot = await asyncio.to_thread(next, shots)
            assert shot.image is not None
            if used and time.monotonic() > used:
                used = 0.0
                came.clear()
                taken = 0
            taken += 1
            out.put(struct.pack(">d", shot.t) + await asyncio.to_thread(encode, shot.image, QUALITY))
        closed.set()
        return result([d for d, _ in came], taken, 0, sum(n for _, n in came), seconds)


def main(seconds: float) -> None:
    columns = (("pictures come", 20), ("delay, median", 22), ("95 %", 16), ("torn", 8), ("kB/s that came", 20))
    print(" " * 30 + "".join(f"{name:>{width}s}" for name, width in columns))
    names = (
        ("plain", 10),
        ("ours", 10),
        ("plain", 8),
        ("ours", 7),
        ("ratio", 7),
        ("plain", 9),
        ("ours", 7),
        ("ours", 8),
    )
    print(f"{'link':30s}" + "".join(f"{name:>{width}s}" for name, width in (*names, ("plain", 12), ("ours", 8))))
    for link in LINKS:
        p, o = asyncio.run(plain(link, seconds)), asyncio.run(ours(link, seconds))
        print(
            f"{link.name:30s}{p.whole:10.0%}{o.whole:10.0%}{p.median:7.2f}s{o.median:6.2f}s{p.median / o.median:7.1f}"
            f"{p.late:8.2f}s{o.late:6.2f}s{o.torn:8.1%}{p.rate / 1e3:12.0f}{o.rate / 1e3:8.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
