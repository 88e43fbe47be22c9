"""A camera's video on the page: a real browser decodes what the camera encoded."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.ground.http.browser import Fleet, Tab, card
from tests.ground.http.camera import FakeCamera
from tests.ground.http.test_operator import at, opened
from tests.ground.http.video import RunningVideo

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

BUTTON = "[data-vehicle=quad1] .cameras button"
CANVAS = f"{card('quad1')}.querySelector('.camera:not([hidden]) canvas:not([hidden])')"
WORDS = f"{card('quad1')}.querySelector('.camera:not([hidden])').innerText"
CLOCK = f"""(() => {{
    const canvas = {CANVAS};
    const row = canvas.getContext("2d").getImageData(0, 8, 512, 1).data;
    let ms = 0;
    for (let i = 0; i < 32; i++) ms = ms * 2 + (row[4 * (16 * i + 8)] > 127 ? 1 : 0);
    return ((Date.now() % 2 ** 32) - ms);
}})()"""
"""ms since the picture on the canvas was taken, by the clock in it"""
PEERS = """window.peers = [];
    window.RTCPeerConnection = class extends RTCPeerConnection {
        constructor(...how) { super(...how); window.peers.push(this); }
    };"""
DECODED = """(async () => {
    const report = await window.peers.at(-1).getStats();
    return [...report.values()].find((each) => each.type === "inbound-rtp")?.framesDecoded ?? 0;
})()"""


@pytest.fixture
def video(served: Served) -> Iterator[RunningVideo]:
    video = RunningVideo(served.endpoint)
    yield video
    video.close()


async def until(tab: Tab, script: str, least: int) -> None:
    end = time.monotonic() + 30.0
    while (found := await tab.run(script)) < least:
        assert time.monotonic() < end, f"{found} of {least}; {await tab.run(WORDS)}; {tab.said}"
        await asyncio.sleep(0.1)


@pytest.mark.asyncio(loop_scope="module")
async def test_a_person_watches_a_cameras_video(tab: Tab, served: Served, fleet: Fleet, video: RunningVideo) -> None:
    fleet.more = {"quad1": at(0, 0)}
    await opened(tab, served)
    await tab.run(PEERS)
    await tab.click("[data-row=quad1]")
    await tab.until(f"document.querySelector('{BUTTON}')?.offsetHeight > 0")
    assert not video.agent.watched, "video crosses the mesh only while somebody watches"
    await tab.click(BUTTON)
    await tab.until(f"{CANVAS} !== null && {WORDS}.includes('640 × 360') && {WORDS}.includes('video')")
    await until(tab, DECODED, 20)
    assert -50 < await tab.run(CLOCK) < 30_000, "the clock in the picture is read: this is the picture that was encoded"
    assert served.gateway.figures["video_viewers"]() == 1
    await tab.click(BUTTON)
    served.until(lambda: not video.agent.watched, "end of watching")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_pictures_come_where_video_does_not(
    tab: Tab, served: Served, fleet: Fleet, video: RunningVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet.more = {"quad1": at(0, 0)}
    camera = FakeCamera(served.session)
    try:
        await opened(tab, served)
        await tab.run("window.RTCPeerConnection = class { constructor() { throw new Error('no WebRTC here'); } }")
        await tab.click("[data-row=quad1]")
        await tab.until(f"document.querySelector('{BUTTON}')?.offsetHeight > 0")
        await tab.click(BUTTON)
        await tab.until(f"{CANVAS} !== null && {WORDS}.includes('320 × 240') && !{WORDS}.includes('video')")
    finally:
        camera.close()
    assert not tab.said
