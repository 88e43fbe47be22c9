"""A gimbal, zoom and photos on the page: dragged and pressed by a person."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.http.guard import Rules
from tests.ground.http.browser import Fleet, Tab, card, pieces, row
from tests.ground.http.camera import FakeCamera
from tests.ground.http.test_operator import TOASTS, at, on_map, opened
from zmav import keys, wire
from zmav.errors import Refused

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

CAMERA = f"{card('quad1')}.querySelector('.camera:not([hidden])')"
CANVAS = f"{CAMERA}.querySelector('canvas:not([hidden])')"
PLACE = f"(() => {{ const b = {CANVAS}.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"


def press(label: str) -> str:
    return f"[...{CAMERA}.querySelectorAll('button')].find((each) => each.textContent === '{label}').click()"


class FakePhotos:
    """The agent that takes photos of quad1's camera down, and what it was asked."""

    def __init__(self, session: zenoh.Session) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.refuses = ""
        key = keys.AGENT_DO.key("demo", "quad1", agent="photos-down", verb="*")
        self._queryable = session.declare_queryable(key, self._answer)

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            verb = str(query.key_expr).rpartition("/")[2]
            args = json.loads(query.payload.to_bytes()) if query.payload else {}
            args.pop("id", None)
            if (verb, args) not in self.asked:
                self.asked.append((verb, args))
            if self.refuses:
                query.reply_err(wire.error_body(Refused(self.refuses)), encoding=keys.JSON)
                return
            result = {"photo": {"number": 7, "file": "photos/quad1-down-00007.jpg"}, "zoom": args}[verb]
            query.reply(query.key_expr, wire.encode(wire.Outcome(verb=verb, status="done", took=0.1, result=result)))

    def close(self) -> None:
        self._queryable.undeclare()


LATE = """(() => {
    const now = window.fetch;
    const asked = new Promise((done) => (window.answered = () => ((window.fetch = now), done())));
    window.fetch = async (...what) => (await asked, now(...what));
})()"""
"""what is asked of the gateway goes out when ``answered()`` is called"""


@pytest.fixture
def photos(served: Served) -> Iterator[FakePhotos]:
    camera, photos = FakeCamera(served.session), FakePhotos(served.session)
    yield photos
    photos.close()
    camera.close()


async def looking(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    fleet.results = {"gimbal_status": {"pitch": -0.5, "yaw": 0.2, "controller": "us"}}
    await opened(tab, served)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{card('quad1')} !== null && {card('quad1')}.querySelector('.cameras button') !== null")
    await tab.click("[data-vehicle=quad1] .cameras button")
    await tab.until(f"{CANVAS} !== null && {CANVAS}.clientHeight > 50")
    fleet.orders.clear()
    fleet.asked.clear()


async def middle(tab: Tab) -> tuple[float, float, float]:
    """Of the picture, and its width, px."""
    left, top, width, height = await tab.run(PLACE)
    return left + width / 2, top + height / 2, width


async def told(tab: Tab, fleet: Fleet, verb: str) -> dict[str, Any]:
    """The arguments of an order to quad1 once it has come."""
    for _ in range(200):
        if (order := f"quad1/do/{verb}") in fleet.orders:
            return fleet.asked[fleet.orders.index(order)]
        await asyncio.sleep(0.05)
    pytest.fail(f"no {verb}: {fleet.orders}, {await tab.run(TOASTS)}")


@pytest.mark.asyncio(loop_scope="module")
async def test_the_picture_is_dragged_and_the_gimbal_turns(
    tab: Tab, served: Served, fleet: Fleet, photos: FakePhotos
) -> None:
    await looking(tab, served, fleet)
    x, y, width = await middle(tab)
    await tab.mouse("mousePressed", x, y)
    await told(tab, fleet, "gimbal_status")
    await tab.mouse("mouseMoved", x + width / 4, y)
    turned = await told(tab, fleet, "gimbal_turn")
    await tab.mouse("mouseReleased", x + width / 4, y)
    assert turned["pitch"] == pytest.approx(-0.5, abs=0.01)
    assert turned["yaw"] == pytest.approx(0.2 - math.radians(60.0) / 4, abs=0.02)
    assert turned.get("take", False) is False
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_drag_that_is_over_before_the_gimbal_says_where_it_is_turns_it_too(
    tab: Tab, served: Served, fleet: Fleet, photos: FakePhotos
) -> None:
    await looking(tab, served, fleet)
    x, y, width = await middle(tab)
    await tab.run(LATE)
    for kind, right in (("mousePressed", 0.0), ("mouseMoved", width / 8), ("mouseReleased", width / 4)):
        await tab.mouse(kind, x + right, y)
    assert not fleet.orders
    await tab.run("answered()")
    turned = await told(tab, fleet, "gimbal_turn")
    assert turned["yaw"] == pytest.approx(0.2 - math.radians(60.0) / 4, abs=0.02)
    await tab.mouse("mouseMoved", x, y)  # nobody holds it any more
    await tab.run(press("Release"))
    await told(tab, fleet, "gimbal_release")
    assert fleet.orders == [f"quad1/do/gimbal_{verb}" for verb in ("status", "turn", "release")]
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_place_of_the_map_is_looked_at(tab: Tab, served: Served, fleet: Fleet, photos: FakePhotos) -> None:
    await looking(tab, served, fleet)
    await tab.run(press("Look at…"))
    await tab.until("document.getElementById('map-tool').innerText.includes('looks at the place')")
    await tab.click(await on_map(tab, "quad1", 0.0, 12.0))
    looked = await told(tab, fleet, "gimbal_point")
    assert looked["lat_deg"] == pytest.approx(-35.3, abs=1e-5)
    assert looked["lon_deg"] == pytest.approx(149.1 + 12.0 / 91000, abs=2e-5)
    await tab.until(f"{TOASTS}.includes('gimbal_point done')")
    await tab.run(press("Take & centre"))
    assert (await told(tab, fleet, "gimbal_turn"))["take"] is True
    await tab.run(press("Release"))
    await told(tab, fleet, "gimbal_release")
    assert "quad1/do/goto" not in fleet.orders


@pytest.mark.asyncio(loop_scope="module")
async def test_zoom_and_a_photo(tab: Tab, served: Served, fleet: Fleet, photos: FakePhotos) -> None:
    await looking(tab, served, fleet)
    await tab.run(press("Photo"))
    await tab.until(f"{TOASTS}.includes('photo 7 is kept in photos/quad1-down-00007.jpg')")
    for label in ("Zoom +", "Zoom +", "Zoom −"):
        count = len(photos.asked)
        await tab.run(press(label))
        for _ in range(100):
            if len(photos.asked) > count:
                break
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.2)
    factors = [args["factor"] for verb, args in photos.asked if verb == "zoom"]
    assert factors[:2] == [1.5, 2.25]
    photos.refuses = "12 MB are free"
    await tab.run(press("Photo"))
    await tab.until(f"{TOASTS}.includes('12 MB are free')")


@pytest.mark.asyncio(loop_scope="module")
async def test_a_viewer_has_no_such_buttons(tab: Tab, serve: Serve) -> None:
    viewer = serve(Rules(token="s3cret", read_only=True))
    with contextlib.closing(FakeCamera(viewer.session)), contextlib.closing(Fleet(viewer)):
        await tab.open(f"http://127.0.0.1:{viewer.port}/?token=s3cret")
        await pieces(tab)
        await tab.until(f"{row('quad1')} !== null")
        await tab.click("[data-row=quad1]")
        await tab.until(f"{card('quad1')} !== null && {card('quad1')}.querySelector('.cameras button') !== null")
        await tab.click("[data-vehicle=quad1] .cameras button")
        await tab.until(f"{CANVAS} !== null")
        assert await tab.run(f"{CAMERA}.querySelectorAll('button').length") == 0
