"""A camera on the page: looked at by a person, with what was found in its pictures."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from ground.http.guard import Rules
from tests.ground.http.browser import Fleet, Tab, card, pieces, row
from tests.ground.http.camera import FakeCamera
from tests.ground.http.test_operator import TOASTS, at, bar, opened
from zmav import keys, wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

BUTTON = f"[...{card('quad1')}.querySelectorAll('.cameras button')].find((each) => each.textContent === 'Camera {{}}')"
DOWN = BUTTON.format("down")
CANVAS = f"{card('quad1')}.querySelector('.camera:not([hidden]) canvas:not([hidden])')"
WORDS = f"{card('quad1')}.querySelector('.camera:not([hidden])').innerText"
PAD = wire.Detection(symbol="H", u=160.0, v=120.0, scale_px=80.0, heading=0.0, score=0.93)


def pixel(x: int, y: int) -> str:
    """Red, green and blue of the picture as it is shown."""
    copied = "new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true })"
    read = f"to.drawImage({CANVAS}, {-x}, {-y}); return [...to.getImageData(0, 0, 1, 1).data].slice(0, 3)"
    return f"(() => {{ const to = {copied}; {read}; }})()"


@pytest.fixture
def camera(served: Served) -> Iterator[FakeCamera]:
    camera = FakeCamera(served.session)
    yield camera
    camera.close()


async def gone(camera: FakeCamera) -> None:
    end = time.monotonic() + 30.0
    while camera.watched:
        assert time.monotonic() < end, "nobody looks any more, and pictures are read"
        await asyncio.sleep(0.05)


@pytest.mark.asyncio(loop_scope="module")
async def test_a_person_looks_through_a_camera(tab: Tab, served: Served, fleet: Fleet, camera: FakeCamera) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    camera.found = [PAD]
    await opened(tab, served)
    await tab.click("#select-all")
    await tab.until(f"{DOWN} !== undefined")
    assert await tab.run(f"{card('quad2')}.querySelector('.cameras').offsetHeight") == 0, "no camera, and no empty box"
    assert await tab.run(f"{CANVAS} === null")
    assert not camera.watched, "pictures cross the mesh only while somebody looks"
    await tab.click("[data-vehicle=quad1] .cameras button")
    await tab.until(f"{CANVAS} !== null && {WORDS}.includes('320 × 240')")
    await tab.until(f"{WORDS}.includes('pictures a second')")
    red, green, blue = await tab.run(pixel(250, 200))
    assert red > 170 and green < 70 and blue < 70, "the camera's own picture"
    side = 80 * 1.3 / 2
    await tab.until(f"(([r, g, b]) => g > 150 && r < 130)({pixel(int(160 - side), 120)})")
    assert "found: H 93 %" in await tab.run(f"{CANVAS}.getAttribute('aria-label')"), "for a screen reader"
    camera.found = []
    await tab.until(f"(([r, g, b]) => r > 170 && g < 70)({pixel(int(160 - side), 120)})")
    broken = b'{"t": 1e18, "width": 320, "height": 240, "found": [null, {"u": "x"}, 7]}'
    served.session.put(keys.DETECTION.key("demo", "quad1", camera="down"), broken)
    await tab.click("[data-vehicle=quad1] .cameras button")
    await tab.until(f"{CANVAS} === null")
    await gone(camera)
    await tab.click("[data-vehicle=quad1] .cameras button")
    await tab.until(f"{CANVAS} !== null")
    await tab.click("[data-row=quad2]")
    await tab.until(f"{card('quad1')} === null")
    await gone(camera)
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_camera_that_stops_is_said_since_when(
    tab: Tab, served: Served, fleet: Fleet, camera: FakeCamera
) -> None:
    fleet.more = {"quad1": at(0, 0)}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{DOWN} !== undefined")
    await tab.click("[data-vehicle=quad1] .cameras button")
    await tab.until(f"{CANVAS} !== null")
    camera.state, camera.text, camera.sends = "lost", "the stream broke off", False
    clock = "new Date().toLocaleTimeString([], { hour12: false })"
    earliest = await tab.run(clock)
    await tab.until(f"{WORDS}.includes('No picture since')")
    await tab.until(f"{WORDS}.includes('the stream broke off')")
    said = await tab.run(WORDS)
    told = said.partition("No picture since ")[2][:8]
    assert abs(_seconds(told) - _seconds(earliest)) <= 2, said
    assert await tab.run(f"getComputedStyle({CANVAS}).filter") == "grayscale(1)", "it does not look like now"
    camera.speaks = False
    await tab.until(f'{WORDS}.includes("the camera\'s program is not heard")')
    assert told in await tab.run(WORDS)
    camera.speaks, camera.sends, camera.state = True, True, "sending"
    await tab.until(f"!{WORDS}.includes('No picture since') && {WORDS}.includes('pictures a second')")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_pictures_leave_connections_for_orders(
    tab: Tab, served: Served, fleet: Fleet, camera: FakeCamera
) -> None:
    fleet.more = {"quad1": at(0, 0)}
    with contextlib.ExitStack() as stack:
        others = [
            stack.enter_context(contextlib.closing(FakeCamera(served.session, camera=name)))
            for name in ("left", "right")
        ]
        await opened(tab, served)
        await tab.click("[data-row=quad1]")
        for name in ("down", "left", "right"):
            await tab.until(f"{BUTTON.format(name)} !== undefined")
            await tab.run(f"{BUTTON.format(name)}.click()")
        await tab.until(f'{TOASTS}.includes("2 cameras at once: quad1\'s down is closed")')
        await gone(camera)
        await tab.until(f"{card('quad1')}.querySelectorAll('.camera:not([hidden]) canvas:not([hidden])').length === 2")
        fleet.orders.clear()
        await tab.run(f"{bar('Hold')}.click()")
        await tab.until(f"{TOASTS}.includes('quad1: hold done')")
        assert all(other.watched for other in others)
        await tab.open("about:blank")
        for other in others:
            await gone(other)


@pytest.mark.asyncio(loop_scope="module")
async def test_a_viewer_may_look(tab: Tab, serve: Serve) -> None:
    viewer = serve(Rules(token="s3cret", read_only=True))
    with contextlib.closing(FakeCamera(viewer.session)) as camera:
        await tab.open(f"http://127.0.0.1:{viewer.port}/?token=s3cret")
        await pieces(tab)
        await tab.until("document.getElementById('link').textContent.startsWith('live')")
        viewer.vehicle("quad1", 1)
        await tab.until(f"{row('quad1')} !== null")
        await tab.size(400, 800)
        await tab.click("[data-row=quad1]")
        await tab.until(f"{DOWN} !== undefined")
        await tab.click("[data-vehicle=quad1] .cameras button")
        await tab.until(f"{CANVAS} !== null && {CANVAS}.clientWidth > 200")
        assert await tab.run("document.documentElement.scrollWidth") <= 400
        assert camera.watched


def _seconds(clock: str) -> int:
    hours, minutes, seconds = map(int, clock.split(":"))
    return 3600 * hours + 60 * minutes + seconds
