"""Video through the gateway: who may watch, several viewers, what is refused, what a hostile vehicle can do."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator
from typing import TYPE_CHECKING, Any

import aiortc
import pytest
from av import VideoFrame

from ground.http.cameras import MOST_EACH
from ground.http.guard import Rules
from tests.ground.http.video import RunningVideo
from zmav import keys
from zmav.vision.chunks import VIDEO, split
from zmav.vision.video import START

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

PATH = "/camera/quad1/down/webrtc"
PATIENCE_S = 30.0


@pytest.fixture
def video(served: Served) -> Iterator[RunningVideo]:
    video = RunningVideo(served.endpoint, "clock:320x240@20")
    yield video
    video.close()


@pytest.fixture(autouse=True)
def nobody(served: Served) -> Iterator[None]:
    """Who watched in a test is gone before the next."""
    yield
    served.until(lambda: served.gateway.figures["video_viewers"]() == 0, "end of those who watch")


class Browser:
    """What a browser does, without one: offers, and decodes what comes."""

    def __init__(self) -> None:
        self.peer = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        self.peer.addTransceiver("video", direction="recvonly")
        self.track: Any = None
        self.peer.add_listener("track", self._on_track)

    def _on_track(self, track: Any) -> None:
        self.track = track

    async def offer(self) -> dict[str, str]:
        await self.peer.setLocalDescription(await self.peer.createOffer())
        return {"sdp": self.peer.localDescription.sdp, "type": "offer"}

    async def watch(self, served: Served, path: str = PATH, **headers: str) -> None:
        answer = await asyncio.to_thread(served.post, path, await self.offer(), **headers)
        assert answer.status == 200, answer.text
        assert answer.headers["cache-control"] == "no-store"
        await self.peer.setRemoteDescription(aiortc.RTCSessionDescription(**answer.json))

    async def see(self, count: int) -> VideoFrame:
        for _ in range(count):
            frame = await asyncio.wait_for(self.track.recv(), PATIENCE_S)
        assert isinstance(frame, VideoFrame)
        return frame


@contextlib.asynccontextmanager
async def browsers(count: int) -> AsyncIterator[list[Browser]]:
    made = [Browser() for _ in range(count)]
    try:
        yield made
    finally:
        for each in made:
            await each.peer.close()


async def test_two_watch_one_camera_and_one_that_stops_changes_nothing(served: Served, video: RunningVideo) -> None:
    figures = served.gateway.figures
    async with browsers(2) as (first, second):
        await first.watch(served)
        frame = await first.see(5)
        assert (frame.width, frame.height) == (320, 240)
        await second.watch(served)
        await second.see(5)
        assert len(video.agent.budget.links) <= 1, "the camera is read once for both"
        assert figures["video_viewers"]() == 2
        await first.peer.close()
        await second.see(10)
        await asyncio.to_thread(served.until, lambda: figures["video_viewers"]() == 1, "end of the first")
        await second.see(5)
        assert video.agent.watched
    await asyncio.to_thread(served.until, lambda: figures["video_viewers"]() == 0, "end of the second")
    await asyncio.to_thread(served.until, lambda: not video.agent.watched, "end of reading")
    assert figures["video_units"]() >= 25
    assert "zmav_http_video_viewers 0" in served.get("/metrics").text


async def test_a_camera_that_is_lost_and_comes_back_goes_on(served: Served) -> None:
    video = RunningVideo(served.endpoint, "clock:320x240@20")
    async with browsers(1) as (one,):
        await one.watch(served)
        await one.see(3)
        await asyncio.to_thread(video.close)
        video = RunningVideo(served.endpoint, "clock:320x240@20")
        try:
            await one.see(10)
        finally:
            await asyncio.to_thread(video.close)


async def test_who_comes_after_the_reading_has_ended_gets_a_new_reader(served: Served, video: RunningVideo) -> None:
    """As where it failed, while those who watched still wait."""
    being_read, place = served.face(PATH_OF).being_read, ("quad1", "down")
    async with browsers(2) as (first, second):
        await first.watch(served)
        await first.see(1)
        shared = being_read[place]
        served.loop.call_soon_threadsafe(shared.close)
        await asyncio.to_thread(served.until, lambda: shared.ended, "end of reading")
        await second.watch(served)
        await second.see(3)
        await first.peer.close()
        await asyncio.to_thread(served.until, lambda: not shared.looking, "end of the first")
        assert being_read[place] is not shared, "who leaves takes nobody else's"
        await second.see(3)


async def test_nothing_is_taken_of_a_browser(served: Served, video: RunningVideo) -> None:
    async with browsers(1) as (one,):
        one.peer.getTransceivers()[0].direction = "sendrecv"
        await one.watch(served)
        assert "a=sendonly" in one.peer.remoteDescription.sdp
        assert "a=sendrecv" not in one.peer.remoteDescription.sdp
        await one.see(2)


async def test_what_is_no_offer_is_refused(served: Served, video: RunningVideo) -> None:
    async with browsers(2) as (with_data, with_two):
        with_data.peer.createDataChannel("x")
        with_two.peer.addTransceiver("audio", direction="recvonly")
        good = (await with_two.offer())["sdp"]
        offers: list[tuple[Any, int]] = [
            (b"", 400),
            (b"[]", 400),
            ({"sdp": "", "type": "offer"}, 400),
            ({"sdp": "v=0\r\n", "type": "offer"}, 400),
            ({"sdp": good, "type": "answer"}, 400),
            ({"sdp": good.replace("H264", "H265"), "type": "offer"}, 400),
            ({"sdp": good + "a=x\r\n" * 20_000, "type": "offer"}, 400),
            (await with_data.offer(), 400),
            (await with_two.offer(), 400),
        ]
        for offer, status in offers:
            answer = await asyncio.to_thread(served.post, PATH, offer)
            assert (answer.status, answer.json["error"]["kind"]) == (status, "bad_input"), offer
    await asyncio.to_thread(served.until, lambda: served.gateway.figures["video_viewers"]() == 0, "end of those before")
    assert not served.face(PATH_OF).being_read, "nobody is left to read for"


PATH_OF = "/camera/{vehicle}/{camera}/webrtc"


async def test_there_is_an_end_to_how_many_watch(served: Served, video: RunningVideo) -> None:
    async with browsers(MOST_EACH + 1) as several:
        for each in several[:-1]:
            await each.watch(served)
            await each.see(1)
        answer = await asyncio.to_thread(served.post, PATH, await several[-1].offer())
        assert (answer.status, answer.json["error"]["kind"]) == (429, "too_many")


async def test_no_such_video(served: Served) -> None:
    async with browsers(1) as (one,):
        offer = await one.offer()
        assert (await asyncio.to_thread(served.post, "/camera/quad1/nowhere/webrtc", offer)).status == 404
        assert (await asyncio.to_thread(served.post, "/camera/Quad*/down/webrtc", offer)).status == 400
        assert (await asyncio.to_thread(served.get, PATH)).status == 405


async def test_who_may_see_the_pictures_may_watch_and_nobody_else(serve: Serve) -> None:
    served = serve(Rules(token="secret", read_only=True))
    video = RunningVideo(served.endpoint, "clock:320x240@20")
    try:
        async with browsers(1) as (one,):
            offer = await one.offer()
            assert (await asyncio.to_thread(served.post, PATH, offer)).status == 401
            elsewhere = {"authorization": "Bearer secret", "origin": "http://elsewhere.example"}
            assert (await asyncio.to_thread(served.post, PATH, offer, **elsewhere)).status == 403
            assert (
                await asyncio.to_thread(served.post, "/do/quad1/arm", {}, authorization="Bearer secret")
            ).status == 403
            await one.watch(served, authorization="Bearer secret")
            await one.see(3)
    finally:
        await asyncio.to_thread(video.close)


async def test_a_hostile_vehicles_units_hurt_no_viewer(served: Served, video: RunningVideo) -> None:
    """Somebody sends as the camera does, at the same time; then as the camera itself, with its number of the sender."""
    async with browsers(1) as (one,):
        await one.watch(served)
        await one.see(3)
        put = served.session.declare_publisher(keys.VIDEO.key("demo", "quad1", camera="down"))
        reader = served.face(PATH_OF).being_read["quad1", "down"].reader
        own = video.agent.sender
        for number, data in enumerate([START * 300, START, b"\xff" * 5000, START + b"\x65\x88", START + b"\x1c\x80"]):
            for sender in (own, 1):
                for chunk in split(
                    b"\x01" + data, sender=sender, seq=video.agent.sent + 1, t=time.time(), size=(1, 1), code=VIDEO
                ):
                    put.put(chunk)
            await asyncio.sleep(0.1 * (number < 3))
        await asyncio.to_thread(served.until, lambda: reader.assembler.bad + reader.assembler.foreign > 0, "harm")
        await one.see(10)
        put.undeclare()
