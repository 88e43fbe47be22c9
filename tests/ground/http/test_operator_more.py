"""The page's survey, missions and timeline, as a person uses them, and what the vehicles were told."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.http.guard import Rules
from ground.record.folder import Record
from ground.record.steering import SteeredPlayer
from tests.ground.http.browser import FakePlanner, Fleet, Tab, pieces, row
from tests.ground.http.test_missions import PLAN
from tests.ground.http.test_operator import TOASTS, at, on_map, opened
from zmav import keys, wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

AREA = "[{lat: -35.3, lon: 149.1}, {lat: -35.299, lon: 149.1}, {lat: -35.299, lon: 149.101}]"
BEGIN, LASTS = 1_700_000_000.0, 60


@pytest.mark.asyncio(loop_scope="module")
async def test_an_area_is_surveyed_with_the_camera_that_was_typed(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.until("store.planner && store.origin")
    await tab.run("showTab('drawing'); store.select(store.all.filter((v) => v.name === 'quad1').map((v) => v.id))")
    await tab.run(f"drawing.shapes.add('search', {AREA}); drawing.refresh()")
    await tab.click(".survey summary")
    given = {"camera": "60x40/35", "pixels": "4000", "height": "70", "front": "80", "side": "50", "heading": "90"}
    for name, value in given.items():
        await tab.run(f"document.querySelector('.survey [name={name}]').value = '{value}'")
        await tab.run(f"document.querySelector('.survey [name={name}]').dispatchEvent(new Event('change'))")
    await tab.click(".survey [name=trigger]")
    await tab.click(".survey button")
    await tab.agree()
    await tab.until("document.querySelector('#goals progress') !== null")
    verb, args = planner.asked[-1]
    goal = args["goal"]
    assert verb == "submit" and goal["kind"] == "survey" and goal["vehicles"] == ["quad1"]
    assert goal["camera"] == pytest.approx([60 / 35, 40 / 35]) and goal["angle"] == pytest.approx(1.5708, abs=1e-4)
    assert (goal["height"], goal["front"], goal["overlap"], goal["pixels"]) == (70, 0.8, 0.5, 4000)
    assert goal["trigger"] is True
    count = len(planner.asked)
    await tab.run("document.querySelector('.survey [name=camera]').value = 'a good one'")
    await tab.run("document.querySelector('.survey [name=camera]').dispatchEvent(new Event('change'))")
    await tab.run("document.querySelector('.survey button').click()")
    await tab.until(f"{TOASTS}.includes('A camera is a sensor over its focal length')")
    assert len(planner.asked) == count


@pytest.mark.asyncio(loop_scope="module")
async def test_a_formation_is_placed_by_a_click_and_a_leader_followed(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.until("store.planner && store.origin")
    count = len(planner.asked)
    await tab.run("showTab('goals'); store.select([])")
    await tab.click("#formation summary")
    await tab.click("[data-tool=formation]")
    await tab.until(f"{TOASTS}.includes('Select who is meant')")
    await tab.run("store.select(store.all.filter((v) => v.name === 'quad1').map((v) => v.id))")
    await tab.run("document.querySelector('#formation select').value = 'vee'")
    await tab.click("[data-tool=formation]")
    assert len(planner.asked) == count
    await tab.click(await on_map(tab, "quad1", 12.0, 5.0))
    await tab.agree()  # "Select who is meant" still stands in the corner, and not over it
    await tab.until(f"{TOASTS}.includes('planner: submit')")
    goal = planner.asked[-1][1]["goal"]
    assert (goal["kind"], goal["vehicles"], goal["shape"], goal["spacing"]) == ("formation", ["quad1"], "vee", 8)
    assert goal["at"] == pytest.approx([12.0, 5.0, -20.0], abs=2.0)

    await tab.click("#follow-form summary")
    assert await tab.run("[...document.querySelectorAll('#follow-form option')].map((o) => o.value)") == ["quad2"]
    await tab.click("#follow-form button")
    await tab.agree()
    await tab.until("!document.getElementById('confirm').open")
    deadline = time.monotonic() + 10.0
    while planner.asked[-1][1]["goal"]["kind"] != "follow" or planner.asked[-1][0] != "submit":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    goal = planner.asked[-1][1]["goal"]
    assert (goal["vehicles"], goal["leader"], goal["offsets"]) == (["quad1"], "quad2", [[-10, 0, -8]])


@pytest.mark.asyncio(loop_scope="module")
async def test_a_file_is_shown_and_uploaded_to_the_selected_alone(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.run("showTab('drawing'); store.select(store.all.filter((v) => v.name === 'quad2').map((v) => v.id))")
    fleet.orders.clear()
    script = f"""(() => {{
        const held = new DataTransfer();
        held.items.add(new File([{json.dumps(PLAN)}], 'field.plan'));
        const input = document.getElementById('mission-file');
        input.files = held.files;
        input.dispatchEvent(new Event('change'));
    }})()"""
    await tab.run(script)
    await tab.until("document.getElementById('confirm').open")
    assert "field.plan" in await tab.text("#confirm-title") and "quad2" in await tab.text("#confirm-title")
    assert "1 mission, 3 fence" in await tab.text("#confirm-text")
    assert fleet.orders == [], "nothing is uploaded before a person agrees"
    await tab.agree()
    await tab.until(f"{TOASTS}.includes('quad2: 1 items of mission, 3 items of fence')")
    assert set(fleet.orders) == {"quad2/do/mission_upload"}


@pytest.mark.asyncio(loop_scope="module")
async def test_what_is_on_the_selected_is_shown(tab: Tab, served: Served, fleet: Fleet) -> None:
    items = [wire.MissionItem(command="MAV_CMD_NAV_WAYPOINT", x=-35.3 + n / 1e4, y=149.1, z=10.0) for n in range(3)]

    def reply(query: zenoh.Query) -> None:
        with query:
            key = keys.MISSION.key("demo", "quad1", kind="mission")
            query.reply(key, wire.encode(wire.Mission(kind="mission", items=items)))

    asked = served.session.declare_queryable(keys.MISSION.key("demo", "quad1", kind="*"), reply)
    try:
        fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
        await opened(tab, served)
        await tab.run("showTab('drawing'); store.select(store.all.filter((v) => v.name === 'quad1').map((v) => v.id))")
        before = await tab.run("document.querySelectorAll('.leaflet-overlay-pane path').length")
        press = "[...document.querySelectorAll('#drawing button')].find((b) => b.textContent === '{}').click()"
        await tab.run(press.format("Show those of the selected"))
        await tab.until("document.querySelector('.missions').innerText.includes('quad1: 3 mission, 0 fence, 0 rally')")
        assert await tab.run("document.querySelectorAll('.leaflet-overlay-pane path').length") == before + 4
        await tab.run(press.format("Hide"))
        assert await tab.run("document.querySelectorAll('.leaflet-overlay-pane path').length") == before
    finally:
        asked.undeclare()


class Minute:
    """A recording of a minute, in which quad9 climbs a metre a second."""

    label = "minute"

    def vehicles(self) -> list[str]:
        return ["quad9"]

    def first(self) -> int | None:
        return int(BEGIN * 1e9)

    def last(self) -> int | None:
        return int((BEGIN + LASTS) * 1e9)

    def records(self, since: int = 0) -> Iterator[Record]:
        for tick in range(LASTS * 5 + 1):
            t = BEGIN + tick / 5.0
            place = wire.GlobalPosition(lat_deg=-35.3, lon_deg=149.1, alt_amsl=600.0, alt_rel=tick / 5.0)
            about: dict[str, Any] = {"fleet": "demo", "name": "quad9", "instance": "i", "connected": True, "sysid": 9}
            state = wire.VehicleState(t=t, position=place, armed=True, replayed=True, **about)
            if int(t * 1e9) >= since:
                yield Record(int(t * 1e9), keys.STATE.key("demo", "quad9"), wire.encode(state))


@pytest.mark.asyncio(loop_scope="module")
async def test_a_recording_has_a_timeline_and_its_mark_and_no_buttons(tab: Tab, serve: Serve) -> None:
    put = list[Any]()
    player = SteeredPlayer([(Minute(), lambda record: put[0](record.key, record.data) if put else None)])
    served = serve(Rules(read_only=True), player=player)
    put.append(served.session.put)
    player.start()
    try:
        await tab.open(f"http://127.0.0.1:{served.port}/")
        await pieces(tab)
        await tab.until(f"{row('quad9')} !== null")
        assert await tab.text(".replay-mark") == "REPLAY"
        await tab.until("document.title.startsWith('REPLAY')")
        mark = "getComputedStyle(document.getElementById('map-frame'), '::after').content"
        assert "REPLAY" in await tab.run(mark)
        assert await tab.run("document.getElementById('everybody').hidden")
        assert not await tab.run("document.getElementById('mission-file')")

        await tab.click("#replay button")
        await tab.until("document.querySelector('#replay button').textContent === 'Play'")
        assert player.playing.paused
        await tab.run("store.takeEvent('quad9', {t: 1, severity: 'info', text: 'of later'})")
        await tab.until("document.getElementById('events').textContent.includes('of later')")
        await tab.run("document.getElementById('replay-time').focus()")
        deadline = time.monotonic() + 30.0
        while abs(player.playing.at - BEGIN - 40.1) > 0.05 and time.monotonic() < deadline:
            # The time as it goes moves the slider, too: also between these two.
            await tab.run("document.getElementById('replay-time').value = '40'")
            await tab.key("ArrowRight")  # a person's step from there
            time.sleep(0.5)
        assert player.playing.at == pytest.approx(BEGIN + 40.1, abs=0.05)
        await tab.until("!document.getElementById('events').textContent.includes('of later')")
        await tab.until("Math.abs(store.all[0].height - 40) < 0.5")
        time.sleep(2.5)
        assert not await tab.run("store.all[0].stale"), "who stands still in a paused recording is not lost"
        await tab.run("document.querySelector('#replay select').value = '10'")
        await tab.run("document.querySelector('#replay select').dispatchEvent(new Event('change'))")
        await tab.click("#replay button")
        await tab.until("store.all[0].height > 59")
        await tab.until("document.querySelector('#replay button').textContent === 'Play'")
    finally:
        player.close()
