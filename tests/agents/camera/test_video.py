"""The agent of a camera's video over real sessions: who watches, what fits through a link, what is dropped."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import random
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import av
import pytest
from click.testing import CliRunner

import zmav
from agents.camera.settings import CameraSettings
from agents.camera.streams import Encoded
from agents.camera.video import VideoAgent
from agents.camera.video_cli import video
from tests.cli.conftest import Process
from tests.waiting import until, wait_until
from zmav import keys, wire
from zmav.doctor.facts import AgentReport, Facts
from zmav.doctor.rules import reasons
from zmav.errors import BadConfig, BadInput, VehicleError, ZmavError
from zmav.process import free_port
from zmav.session import SessionSettings
from zmav.vision.mux import Muxer
from zmav.vision.video import START, Unit, VideoReader, video_info

if TYPE_CHECKING:
    import zenoh

    from tests.conftest import Net

VERB = "import sys; from zmav import cli; from agents.camera.video_cli import video; cli.zmav = video; cli.main()"
FLEET = """
[vehicles.quad1]
link = "udpin:127.0.0.1:1"
[vehicles.quad1.cameras.down]
streams = ["clock:320x240@20"]
"""
HEAD = START + b"\x67\x42\xc0\x1e" + START + b"\x68\xce\x3c\x80"


class Played:
    """A camera of ``size`` bytes a unit at ``rate`` Hz, every ``group``-th a key frame."""

    def __init__(self, rate: float = 30.0, size: int = 2000, group: int = 10, tells: bool = False) -> None:
        self.words = f"played, {size} bytes at {rate:g} Hz"
        self.rate, self.size, self.group, self.tells = rate, size, group, tells
        self.wishes = 0
        self.told: list[float] = []
        self.opened = 0
        self._rng = random.Random(1)

    def check(self) -> None:
        """There is nothing that could be missing."""

    def shots(self, closed: threading.Event) -> Iterator[Encoded]:
        self.opened += 1
        number = 0
        while not closed.wait(1.0 / self.rate):
            key = number % self.group == 0
            body = self._rng.randbytes(self.size).replace(b"\0", b"\1")
            data = (HEAD + START + b"\x65" if key else START + b"\x41") + body
            yield Encoded(data, key, time.time(), 1280, 720)
            number += 1

    def aim(self, bits: float) -> bool:
        if self.tells:
            self.told.append(bits)
            self.size = int(bits / 8.0 / self.rate)
        return self.tells

    def want_key(self) -> None:
        self.wishes += 1


Run = Callable[..., Any]
Start = Callable[..., Process]


@pytest.fixture
async def run_video(net: Net) -> AsyncIterator[Run]:
    """``await run_video(endpoint, *streams, **settings)``: a running agent of quad1's camera ``down``."""
    async with AsyncExitStack() as stack:

        async def run(endpoint: str, *streams: Any, say: Any = None, **how: Any) -> VideoAgent:
            settings = SessionSettings(connect=[endpoint])
            z = await stack.enter_async_context(zmav.open(settings=settings))
            own = CameraSettings(vehicle="quad1", **how)
            agent: VideoAgent = await stack.enter_async_context(
                VideoAgent(z, own, streams or (Played(),), say or (lambda line: None))
            )
            return agent

        yield run


def reading(endpoint: str) -> Any:
    return zmav.open(settings=SessionSettings(connect=[endpoint]))


class Link:
    """Carries what a camera sends from one router to another, and the reports back. ``lose``: a share of chunks;
    ``rate``: B/s that go through, with room for ``queue`` bytes that wait.
    """

    def __init__(
        self,
        near: zenoh.Session,
        far: zenoh.Session,
        lose: float = 0.0,
        rate: float | None = None,
        queue: float = 8000.0,
    ) -> None:
        self.bytes = self.lost = 0
        self._rng, self._lose, self._rate, self._queue, self._free = random.Random(1), lose, rate, queue, 0.0
        self._loop = asyncio.get_running_loop()
        key = keys.VIDEO.key("demo", "quad1", camera="down")
        self._out = far.declare_publisher(key, **keys.VIDEO.publishing())
        report = keys.VIDEO_REPORT.key("demo", "quad1", camera="down", reader="*")
        self._held = [
            near.declare_subscriber(key, lambda sample: self._loop.call_soon_threadsafe(self._take, sample)),
            far.declare_subscriber(report, lambda sample: near.put(sample.key_expr, sample.payload)),
        ]

    def _take(self, sample: zenoh.Sample) -> None:
        data, now = sample.payload.to_bytes(), time.monotonic()
        self._free = max(self._free, now)
        full = self._rate is not None and (self._free - now) * self._rate > self._queue
        if full or self._rng.random() < self._lose:
            self.lost += 1
            return
        self.bytes += len(data)
        if self._rate is None:
            self._out.put(data)
            return
        self._free += len(data) / self._rate
        self._loop.call_later(self._free - now, self._out.put, data)


async def test_nothing_is_sent_while_nobody_watches_and_all_from_a_key_frame_on(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    played = Played()
    agent = await run_video(endpoint, played, budget=2e6)
    await until(lambda: agent.capture.count >= 15, "units of the camera")
    assert (agent.sent, agent.watched, played.wishes) == (0, False, 0)
    async with reading(endpoint) as z:
        async with VideoReader(z, "quad1") as reader:
            with reader.units() as units, reader.units() as others:
                found = [await units.get() for _ in range(25)]
                assert found[0].key
                assert [unit.seq for unit in found] == list(range(found[0].seq, found[0].seq + 25))
                assert {(unit.width, unit.height) for unit in found} == {(1280, 720)}
                assert (await others.get()).seq == found[0].seq
                assert played.wishes >= 1, "the camera is asked for a key frame"
            info = await video_info(z, "quad1", "down")
            assert (info.camera, info.streams, info.key_frames_only, info.source) == ("down", 1, False, played.words)
            assert 5.0 < info.rate_hz <= 40.0
        await until(lambda: not agent.watched, "the reader's leaving")
        with pytest.raises(VehicleError, match="no video 'front'"):
            await video_info(z, "quad1", "front", timeout=0.5)
    assert agent.bad == agent.failed == 0


async def test_an_encoder_is_told_what_the_link_takes(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    played = Played(tells=True)
    await run_video(endpoint, played, budget=60e3)
    async with reading(endpoint) as z, VideoReader(z, "quad1", most_bytes=40e3) as reader:
        await until(lambda: len(played.told) >= 2 and played.told[-1] < 8 * 40e3, "a word to the encoder")
        assert reader.most_bytes == 40e3
        assert played.told[-1] > 0.5 * 8 * 40e3 / 2, "most of it is the video's"


async def test_a_leaner_stream_is_taken_and_at_the_end_key_frames_only(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    rich, lean, said = Played(size=4000), Played(size=1500), list[str]()
    agent = await run_video(endpoint, rich, lean, say=said.append, budget=150e3)
    assert (rich.opened, lean.opened) == (1, 0)
    async with reading(endpoint) as z, VideoReader(z, "quad1", most_bytes=60e3) as reader:
        word = "down: stream 2 of 2, played, 1500 bytes"
        await until(lambda: any(line.startswith(word) for line in said), "the leaner stream")
        assert agent.rungs.at == 1
        reader.most_bytes = 15e3
        await until(lambda: agent.rungs.key_only, "key frames only")
        assert "key frames only: the stream needs" in agent.words()
        with reader.units() as units:
            assert [(await units.get()).key for _ in range(3)] == [True] * 3
        assert (await video_info(z, "quad1", "down")).key_frames_only


async def test_a_queue_never_grows(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    agent = await run_video(endpoint, Played(size=20_000), budget=100e3)
    async with reading(endpoint) as z, VideoReader(z, "quad1", most_bytes=100e3) as reader:
        with reader.units() as units:
            found = [await units.get() for _ in range(15)]
    assert agent.dropped > 0, "600 kB/s do not go through 100 kB/s"
    assert agent.waiting_bytes <= 3 * 100e3
    for before, after in itertools.pairwise(found):
        assert after.key or after.seq == before.seq + 1, "never one without what it follows"


async def test_loss_is_mended(net: Net, run_video: Run) -> None:
    (near, here), (far, there) = net.router(), net.router()
    link = Link(near, far, lose=0.05)
    agent = await run_video(here, Played(size=3500, group=30), budget=1e6)
    async with reading(there) as z, VideoReader(z, "quad1") as reader:
        await until(lambda: reader.came >= 150, "units")
        assert link.lost > 20
        assert reader.assembler.mended > 0
        assert reader.assembler.torn <= 5, "of more than 150"
        assert agent.budget.links


async def test_a_camera_that_sends_garbage_is_said_and_opened_again(net: Net, run_video: Run, tmp_path: Path) -> None:
    from agents.camera.streams import Contained

    path = tmp_path / "film.ts"
    path.write_bytes(random.Random(1).randbytes(50_000))
    _, endpoint = net.router()
    said = list[str]()
    agent = await run_video(endpoint, Contained(str(path), loop=True), say=said.append)
    await until(lambda: bool(agent.capture.lost), "the loss")
    async with reading(endpoint) as z:
        assert "opened again" in (await video_info(z, "quad1", "down")).lost
        async with z.subscribe(keys.AGENT_STATUS.key("demo", "quad1", agent="video-down")) as statuses:
            status = wire.decode((await statuses.get()).payload.to_bytes(), wire.AgentStatus, "status")
        found = AgentReport.of("demo", "quad1", status, 0.0)
        (reason,) = reasons(Facts(name="quad1", agents=(found,)))
        assert reason.text.startswith("agent video-down lost"), "doctor, top and the page say so"
    assert "film.ts" in said[0]


async def test_a_unit_that_is_too_large_is_said(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    agent = await run_video(endpoint, Played(size=1_100_000, rate=5.0), budget=1e7, most=1e8)
    async with reading(endpoint) as z, VideoReader(z, "quad1"):
        await until(lambda: agent.failed >= 1, "the failure")
        assert "cannot be sent" in agent.wrong


def test_who_takes_nothing_of_what_is_passed_on_is_given_up() -> None:
    unit = Unit(HEAD + START + b"\x65" + b"\1" * 900_000, True, 1.0, 0, 1280, 720, 1.0)
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        there.listen()
        muxer = Muxer(f"tcp://127.0.0.1:{there.getsockname()[1]}", unit)
        with pytest.raises(BadInput, match="timed out"):
            for number in range(30):
                muxer.add(unit._replace(t=1.0 + number / 30.0))
        with contextlib.suppress(BadInput):
            muxer.close()


async def test_a_camera_without_streams_is_none(net: Net, run_video: Run) -> None:
    _, endpoint = net.router()
    async with reading(endpoint) as z:
        with pytest.raises(BadConfig, match="without a stream"):
            VideoAgent(z, CameraSettings(vehicle="quad1"), [])


class TestCommands:
    """``zmav video`` in processes of its own."""

    @pytest.fixture
    def start(self) -> Iterator[Start]:
        started: list[Process] = []

        def run(*arguments: str) -> Process:
            started.append(Process(sys.executable, "-c", VERB, *arguments))
            return started[-1]

        yield run
        for process in started:
            if process.popen.poll() is None:
                process.popen.kill()
                process.wait()

    def test_it_is_sent_listed_shown_and_passed_on(
        self, net: Net, tmp_path: Path, start: Callable[..., Process]
    ) -> None:
        _, endpoint = net.router()
        fleet = tmp_path / "fleet.toml"
        fleet.write_text(FLEET)
        camera = start("run", "--file", str(fleet), "--vehicle", "quad1", "-e", endpoint)
        wait_until(lambda: any("a test picture" in line for line in (*camera.out, *camera.err)), "the camera")
        path, port = tmp_path / "down.ts", free_port()
        kept = start("show", "quad1", "--to", str(path), "--json", "-e", endpoint)
        description = tmp_path / "down.sdp"
        start("show", "quad1", "--to", f"rtp://127.0.0.1:{port}", "--sdp", str(description), "-e", endpoint)
        wait_until(lambda: len(kept.out) >= 3, "figures")
        told = json.loads(kept.out[-1])
        assert (told["width"], told["height"], told["bad"]) == (320, 240, 0)
        listed = start("ls", "--json", "-e", endpoint)
        listed.wait()
        (one,) = [json.loads(line) for line in listed.out]
        assert (one["vehicle"], one["camera"], one["width"]) == ("quad1", "down", 320)
        options = {"protocol_whitelist": "file,rtp,udp"}
        with av.open(str(description), options=options, timeout=30.0) as container:
            assert next(iter(container.decode(video=0))).width == 320
        kept.popen.kill()
        kept.wait()
        with av.open(str(path)) as container:
            assert sum(1 for _ in container.decode(video=0)) >= 10

    def test_what_cannot_be_is_said(self, net: Net, start: Start) -> None:
        _, endpoint = net.router()
        process = start("run", "--vehicle", "quad1", "-e", endpoint)
        assert process.wait() != 0
        assert "give a SOURCE, or --file" in " ".join(" ".join(process.err).split())
        for arguments, words in (
            (("run", "/nowhere.mp4", "--vehicle", "quad1"), "neither a device, a URL nor a file"),
            (("show", "quad1", "--sdp", "x"), "--sdp goes with --to rtp://"),
            (("show", "quad1", "--sdp", "x", "--to", "rtp://127.0.0.1"), "is no rtp://HOST:PORT"),
            (("show", "quad1", "--sdp", "x", "--to", "rtp://127.0.0.1:99999"), "is no rtp://HOST:PORT"),
            (("show", "quad1", "--wait", "0.5"), "quad1 has no video 'down'"),
        ):
            with pytest.raises(ZmavError, match=words):
                CliRunner().invoke(video, [*arguments, "-e", endpoint], catch_exceptions=False)
