"""What an operator does on the page, with pointer and keys, and what the vehicles get."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
import time
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ground.http.guard import Rules
from tests.ground.http.browser import FakePlanner, Fleet, Tab, card, pieces, row
from zmav import wire
from zmav.mavlink import load_dialect
from zmav.vehicle.missions import plans_of
from zmav.wire import swarm

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

TOASTS = "document.getElementById('toasts').innerText"
LEAST = 1e-5
"""degrees of latitude: a metre"""


def at(north: float, east: float, **more: Any) -> dict[str, Any]:
    """A state about an origin, in metres."""
    lat, lon = -35.3 + north / 110940, 149.1 + east / 91000
    place = wire.GlobalPosition(lat_deg=lat, lon_deg=lon, alt_amsl=600.0, alt_rel=10.0)
    return {"position": place, "local": (north, east, -10.0), "mode": "GUIDED", "armed": True, **more}


async def opened(tab: Tab, served: Served, *names: str) -> None:
    """The page, once it has heard what the vehicles are now: the gateway knows what they were in the test before."""
    now = time.time()
    await tab.open(f"http://127.0.0.1:{served.port}/", (1400, 900))
    await pieces(tab)
    for name in names or ("quad1", "quad2"):
        await tab.until(f"{row(name)} !== null && store.named('{name}').state.t > {now}")
    await tab.until("document.getElementById('link').textContent.startsWith('live')")
    await tab.until("map.fitted")
    await tab.run("localStorage.clear(); drawing.shapes.all = []; drawing.refresh(); store.groups = {}")
    await tab.run("map.fit(map.placesShown); map.follow(false)")  # nothing moves under the pointer


async def on_map(tab: Tab, name: str, north: float = 0.0, east: float = 0.0) -> tuple[float, float]:
    """Where metres from a vehicle are in the window."""
    script = f"""(() => {{
        const area = map.element.getBoundingClientRect();
        const place = store.all.find((each) => each.name === '{name}').place;
        const there = toGlobal(place, {north}, {east});
        const point = map.map.latLngToContainerPoint([there.lat, there.lon]);
        return [area.left + point.x, area.top + point.y];
    }})()"""
    x, y = await tab.run(script)
    return x, y


async def selected(tab: Tab) -> list[str]:
    found: list[str] = await tab.run("store.chosen.map((vehicle) => vehicle.name)")
    return found


# What is served.


def test_what_is_vendored_is_what_the_manifest_says() -> None:
    folder = Path(str(resources.files("ground.http").joinpath("static", "vendor")))
    listed = {"manifest.json"}
    for library in json.loads((folder / "manifest.json").read_text("utf-8")):
        assert re.fullmatch(r"\d+\.\d+\.\d+", library["version"])
        assert library["licence"]
        assert library["integrity"].startswith("sha512-")
        for name, digest in library["files"].items():
            assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name
            listed.add(name)
    assert {each.name for each in folder.iterdir()} == listed
    assert (folder / "land-110m.json").stat().st_size < 150_000


def test_the_report_is_that_of_top(served: Served) -> None:
    served.vehicle("quad1", 1, battery=wire.Battery(remaining=0.05))
    report = served.get("/report").json
    quad1 = next(each for each in report["vehicles"] if each["name"] == "quad1")
    assert quad1["level"] == "bad"
    assert "battery-empty" in [reason["rule"] for reason in quad1["reasons"]]
    assert report["links"] == []


def test_a_planner_is_asked_only_where_there_is_one(served: Served) -> None:
    reply = served.post("/swarm/pause", {})
    assert (reply.status, reply.json["error"]["kind"]) == (404, "no_such_vehicle")
    assert "zmav swarm planner" in reply.json["error"]["text"]
    assert served.post("/swarm/dance", {}).status == 400
    assert served.post("/swarm/submit", {"goal": {"kind": "goto"}}).status == 400


# The map.


@pytest.mark.asyncio(loop_scope="module")
async def test_the_map_is_moved_and_measures(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    zoom = await tab.run("map.map.getZoom()")
    await tab.click("#zoom-in")
    await tab.until(f"map.map.getZoom() > {zoom}")
    await tab.click("#fit")
    await tab.until(f"map.map.getZoom() === {zoom}")
    before = await tab.run("map.map.getCenter().lng")
    start = await on_map(tab, "quad1", 20, 10)
    await tab.drag(start, (start[0] + 120, start[1]))
    assert await tab.run("map.map.getCenter().lng") < before
    assert "a square is" in await tab.text("#map-note")
    assert re.search(r"\d+ m", await tab.text(".leaflet-control-scale-line"))
    await tab.click("#fit")
    await tab.click("#measure")
    await tab.click(await on_map(tab, "quad1", -10, 0))
    await tab.click(await on_map(tab, "quad1", -10, 30))
    await tab.until("document.querySelector('.measured').innerText.match(/^(29|30|31)\\.\\d m at (89|90|91)°/)")
    await tab.key("Escape")
    await tab.until("document.querySelector('.measured') === null && document.getElementById('map-tool').hidden")
    await tab.run("map.map.setView([20, 0], 1.5); null")
    await tab.until("map.map.hasLayer(map.land)")
    await tab.run("map.map.setView([20, 0], 14); null")
    await tab.until("!map.map.hasLayer(map.land)")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_labels_do_not_overprint(tab: Tab, served: Served, fleet: Fleet) -> None:
    """Sixteen vehicles ten metres apart, all in view: each has its name, and no two names meet."""
    fleet.names = [f"quad{number}" for number in range(1, 17)]
    fleet.more = {name: at(10.0 * (i // 4), 10.0 * (i % 4)) for i, name in enumerate(fleet.names)}
    await opened(tab, served, "quad16")
    await tab.click("#fit")
    await asyncio.sleep(0.5)
    boxes = await tab.run("""[...document.querySelectorAll('.label')].filter((each) => !each.hidden)
        .map((each) => each.getBoundingClientRect()).map((b) => [b.left, b.top, b.right, b.bottom])""")
    assert len(boxes) == 16
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]


@pytest.mark.asyncio(loop_scope="module")
async def test_a_local_frame_has_a_map_too(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.names = ["lab1", "lab2"]
    fleet.more = {"lab1": at(0, 0, position=None), "lab2": at(3, 4, position=None)}
    fresh = f"http://127.0.0.1:{served.port}/"
    await tab.open(fresh)
    await pieces(tab)
    await tab.until(f"{row('lab1')} !== null && {row('lab2')} !== null && map.fitted")
    await tab.run("for (const id of [...store.vehicles.keys()]) if (!id.includes('lab')) store.vehicles.delete(id)")
    found = await tab.run("(([a, b]) => wayBetween(a.place, b.place).distance)(store.all.filter((v) => v.place))")
    assert found == pytest.approx(5.0, abs=0.05)


# Who is meant.


@pytest.mark.asyncio(loop_scope="module")
async def test_fifty_are_sorted_filtered_and_counted(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.names = [f"quad{number}" for number in range(1, 51)]
    fleet.more = {name: at(12.0 * (i // 10), 12.0 * (i % 10)) for i, name in enumerate(fleet.names)}
    for name, charge in (("quad33", 0.05), ("quad40", 0.2), ("quad41", 0.2)):
        fleet.more[name]["battery"] = wire.Battery(remaining=charge)
    await opened(tab, served, "quad50")
    rows = "[...document.querySelectorAll('#table tbody tr:not([hidden])')].map((each) => each.dataset.row)"
    await tab.until(f"JSON.stringify({rows}.slice(0, 4)) === JSON.stringify(['quad33', 'quad40', 'quad41', 'quad1'])")
    assert "battery 5%" in await tab.text("#table tbody tr")
    await tab.click("#counts .warn")
    assert await selected(tab) == ["quad40", "quad41"]
    await tab.until("document.querySelectorAll('article.card').length === 2")
    await tab.key("Escape")
    assert await selected(tab) == []
    await tab.key("/")
    await tab.call("Input.insertText", text="quad1")
    await tab.until(f"{rows}.length === 11")
    await tab.click("#select-all")
    assert len(await selected(tab)) == 11
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_selecting_by_click_box_group_and_keys(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.names = ["quad1", "quad2", "quad3"]
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20), "quad3": at(0, 40)}
    await opened(tab, served, "quad3")
    await tab.run("map.fit(store.all.filter((v) => ['quad1', 'quad2', 'quad3'].includes(v.name)).map((v) => v.place))")
    await tab.click(await on_map(tab, "quad2"))
    assert await selected(tab) == ["quad2"]
    await tab.drag(await on_map(tab, "quad1", 8, -5), await on_map(tab, "quad2", -8, 5), shift=True)
    assert await selected(tab) == ["quad1", "quad2"]
    await tab.until("document.getElementById('whom').innerText.includes('quad1, quad2')")
    await tab.click("#save-group")
    await tab.call("Input.insertText", text="left")
    await tab.agree()
    await tab.until("document.querySelector('#groups button') !== null")
    await tab.click("[data-row=quad3]")
    assert await selected(tab) == ["quad3"]
    await tab.key(" ")
    assert await selected(tab) == []
    await tab.click("#groups button")
    assert await selected(tab) == ["quad1", "quad2"]
    fleet.names.append("newcomer")
    fleet.more["newcomer"] = at(15, 15)
    await tab.until(f"{row('newcomer')} !== null")
    assert await selected(tab) == ["quad1", "quad2"], "a vehicle that appears takes no selection"
    assert not tab.said


# Orders.


def bar(label: str) -> str:
    return f"[...document.querySelectorAll('#bar button')].find((each) => each.textContent.startsWith('{label}'))"


@pytest.mark.asyncio(loop_scope="module")
async def test_the_bar_names_whom_it_means(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20, armed=False)}
    await opened(tab, served)
    assert (await tab.text("#whom")).startswith("for all")
    assert await tab.run(f"{bar('Arm')}.disabled && {bar('Go here')}.disabled"), "what moves asks for a selection"
    fleet.orders.clear()
    await tab.click("[data-row=quad1]")
    await tab.until(f"{bar('Hold quad1')} !== undefined")
    await tab.run(f"{bar('Hold')}.click()")
    await tab.until(f"{TOASTS}.includes('quad1: hold done')")
    await tab.click("#select-all")
    await tab.press_twice(bar("Land"))
    await tab.until(
        f"{TOASTS}.includes('quad1: land done') && {TOASTS}.includes('quad2: land left out: it is disarmed')"
    )
    assert [order for order in fleet.orders if order != "quad1/do/hold"] == ["quad1/do/land"]
    await tab.run(f"{bar('Return')}.click()")
    await tab.until(f"{bar('Return')}.textContent.endsWith('?')")
    await tab.click("[data-row=quad2]")
    assert not await tab.run(f"{bar('Return')}.classList.contains('asking')"), "the first press was for others"
    await tab.run(f"{bar('Mode')}.click()")
    await tab.click("#confirm button[value=no]")  # also while nothing is entered
    await tab.until("!document.getElementById('confirm').open")
    await tab.run(f"{bar('Mode')}.click()")
    await tab.call("Input.insertText", text="LOITER")
    await tab.agree()
    await tab.until(f"{TOASTS}.includes('quad2: set_mode done')")
    assert fleet.asked[fleet.orders.index("quad2/do/set_mode")]["mode"] == "LOITER"
    await tab.run("store.select(['demo/quad2', 'demo/gone'])")  # as a group does of which one is not there
    assert "quad2, gone" in await tab.text("#whom")
    await tab.run(f"{bar('Hold')}.click()")
    await tab.until(f"{TOASTS}.includes('quad2: hold done') && {TOASTS}.includes('gone: not told')")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_go_here_without_a_planner_is_straight(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.click("#select-all")
    await tab.run(f"{bar('Go here')}.click()")
    await tab.click(await on_map(tab, "quad1", 12, -6))
    await tab.until(f"{TOASTS}.includes('Several are led by the planner only')")
    await tab.click("[data-row=quad1]")
    fleet.orders.clear()
    fleet.asked.clear()
    await tab.run(f"{bar('Go here')}.click()")
    await tab.click(await on_map(tab, "quad1", 12, -6))
    await tab.until("document.getElementById('confirm').open")
    assert "quad1" in await tab.text("#confirm-title")
    await tab.agree()
    await tab.until(f"{TOASTS}.includes('quad1: goto done')")
    told = fleet.asked[fleet.orders.index("quad1/do/goto")]
    assert told["frame"] == "global"
    assert told["lat_deg"] == pytest.approx(-35.3 + 12 / 110940, abs=LEAST)
    assert told["lon_deg"] == pytest.approx(149.1 - 6 / 91000, abs=LEAST)
    assert told["alt_rel"] == 10.0


@pytest.mark.asyncio(loop_scope="module")
async def test_go_here_by_the_planner_is_shown_first(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.until("store.planner && store.origin")
    await tab.click("#filter")
    await tab.call("Input.insertText", text="quad")
    await tab.click("#select-all")
    await tab.run("store.select(store.all.filter((v) => ['quad1', 'quad2'].includes(v.name)).map((v) => v.id))")
    await tab.run(f"{bar('Go here')}.click()")
    await tab.click(await on_map(tab, "quad1", 10, -5))
    await tab.until("document.getElementById('confirm').open")
    assert "9.0 s, 3.2 m between the nearest two" in await tab.text("#confirm-text"), "all of it, not the plan alone"
    assert await tab.run("plans.previewed.length") == 1, "the ways are on the map while it asks"
    assert [verb for verb, _ in planner.asked] == ["preview"], "nothing is flown before a person agrees"
    await tab.agree()
    await tab.until("document.querySelector('#goals progress') !== null")
    verb, args = planner.asked[-1]
    assert (verb, args["goal"]["vehicles"]) == ("submit", ["quad1", "quad2"])
    (north, east, down), second = args["goal"]["to"]
    assert (north, east, down) == (pytest.approx(10, abs=0.6), pytest.approx(-15, abs=0.6), -10.0)
    assert second[1] - east == pytest.approx(20.0, abs=0.1), "they keep their places about their middle"
    await tab.run("showTab('goals')")
    assert "40 %" in await tab.text("#goals")
    await tab.run(f"{bar('Pause')}.click()")
    await tab.until(f"{TOASTS}.includes('planner: pause')")
    assert planner.asked[-1][0] == "pause"
    stop = "[...document.querySelectorAll('#goals button')].find((each) => each.textContent.startsWith('Stop'))"
    await tab.press_twice(stop)
    await tab.until("document.querySelector('#goals progress') === null")
    assert planner.asked[-1] == ("cancel", planner.asked[-1][1] | {"goal": "g1"})
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_several_take_off_when_nothing_hinders_any(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    ground = {"armed": False, "landed": True, "ready": True}
    fleet.more = {"quad1": at(0, 0, **ground), "quad2": at(0, 20, **ground | {"not_ready": ["Compass not calibrated"]})}
    await opened(tab, served)
    await tab.until("store.planner")
    await tab.run("store.select(store.all.filter((v) => ['quad1', 'quad2'].includes(v.name)).map((v) => v.id))")
    fleet.orders.clear()
    await tab.run("document.querySelector('[data-tab=preflight]').click()")
    await tab.until("document.getElementById('preflight').innerText.includes('Compass not calibrated')")
    await tab.run(f"{bar('Take off')}.click()")
    await tab.until(f"{TOASTS}.includes('No takeoff of 2: quad2: Compass not calibrated')")
    assert not await tab.run("document.getElementById('confirm').open")
    del fleet.more["quad2"]["not_ready"]
    await tab.until("document.getElementById('preflight').innerText.includes('Nothing hinders the 2 selected')")
    await tab.run(f"{bar('Take off')}.click()")
    await tab.agree()
    await tab.until("document.querySelector('#goals progress') !== null")
    assert planner.asked[-1][0] == "submit"
    assert planner.asked[-1][1]["goal"] == {"kind": "takeoff", "vehicles": ["quad1", "quad2"], "height": 10}
    assert fleet.orders == []


# Alarms.


@pytest.mark.asyncio(loop_scope="module")
async def test_alarms_are_seen_by_hand_and_stay_until_gone(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0, battery=wire.Battery(remaining=0.05)), "quad2": at(0, 20)}
    await opened(tab, served)
    first = "document.querySelector('.alarms li.bad:not(.seen)')"
    await tab.until("[...document.querySelectorAll('.alarms li.bad')].some((e) => e.innerText.includes('battery 5%'))")
    alarm = "[...document.querySelectorAll('.alarms li')].find((each) => each.innerText.includes('battery 5%'))"
    assert "land it" in await tab.run(f"{alarm}.innerText"), "what to do about it"
    assert first
    await tab.run(f"{alarm}.querySelector('button.small').click()")
    await tab.until(f"{alarm}.classList.contains('seen')")
    await tab.open(f"http://127.0.0.1:{served.port}/")  # again, as after a reload
    await tab.until(f"{alarm}.classList.contains('seen')")
    fleet.more["quad1"]["battery"] = wire.Battery(remaining=0.9)
    await tab.until(f"{alarm} === undefined")
    fleet.more["quad1"]["battery"] = wire.Battery(remaining=0.05)
    await tab.until(f"{alarm} !== undefined && !{alarm}.classList.contains('seen')")
    assert not tab.said


# Drawing.


@pytest.mark.asyncio(loop_scope="module")
async def test_areas_are_drawn_edited_undone_and_saved(tab: Tab, served: Served, fleet: Fleet, tmp_path: Path) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.run("map.fit(store.all.filter((v) => ['quad1', 'quad2'].includes(v.name)).map((v) => v.place))")
    await tab.run("showTab('drawing')")
    await tab.click("[data-tool=geofence]")
    for north, east in ((5, 5), (5, 30), (-15, 30), (-15, 5)):
        await tab.click(await on_map(tab, "quad1", north, east))
    await tab.key("Enter")
    await tab.until("drawing.shapes.all.length === 1")
    await tab.drag(await on_map(tab, "quad1", -15, 30), await on_map(tab, "quad1", -20, 35))
    moved = "toNed(store.all.find((v) => v.name === 'quad1').place, drawing.shapes.all[0].points[2])"
    north, east = await tab.run(moved)
    assert (north, east) == (pytest.approx(-20, abs=1), pytest.approx(35, abs=1))
    await tab.drag(await on_map(tab, "quad1", 5, 17.5), await on_map(tab, "quad1", 12, 17.5))
    assert await tab.run("drawing.shapes.all[0].points.length") == 5, "a corner between two is made by dragging"
    await tab.key("z")
    await tab.run("drawing.back(); drawing.back()")
    north, east = await tab.run(moved)
    assert (north, east) == (pytest.approx(-15, abs=1), pytest.approx(30, abs=1))
    await tab.click("[data-tool=obstacle]")
    await tab.click(await on_map(tab, "quad1", -5, 12))
    await tab.until("drawing.shapes.all.length === 2")
    file = tmp_path / "fence.plan"
    file.write_text(await tab.run("JSON.stringify(planFileOf(drawing.shapes.all))"))
    fence = [item.command for item in plans_of(str(file), "fence", load_dialect())["fence"]]
    assert fence.count("MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION") == 4
    assert "MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION" in fence
    line = await tab.run("commandOf(drawing.shapes.all[0], store.origin, [])")
    wanted = r"zmav swarm obstacle add fence1 --geofence='(-?[\d.]+,-?[\d.]+ ?){4}' --floor -5 --ceiling 120"
    assert re.fullmatch(wanted, line)
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_drawn_area_is_searched_and_a_no_fly_given(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.run("map.fit(store.all.filter((v) => ['quad1', 'quad2'].includes(v.name)).map((v) => v.place))")
    await tab.until("store.planner && store.origin")
    await tab.run("showTab('drawing'); store.select(store.all.filter((v) => v.name === 'quad1').map((v) => v.id))")
    await tab.click("[data-tool=search]")
    for north, east in ((5, 5), (5, 30), (-15, 30), (5, 5)):  # the last click is on the first corner
        await tab.click(await on_map(tab, "quad1", north, east))
    await tab.until("drawing.shapes.all.length === 1")
    press = "[...document.querySelectorAll('.shapes button')].find((each) => each.textContent.startsWith('{}')).click()"
    await tab.run(press.format("Search it"))
    await tab.agree()
    await tab.until("document.querySelector('#goals progress') !== null")
    goal = planner.asked[-1][1]["goal"]
    assert (goal["kind"], goal["vehicles"], goal["height"], len(goal["polygon"])) == ("search", ["quad1"], 20, 3)
    await tab.run("drawing.shapes.add('no_fly', drawing.shapes.all[0].points); drawing.refresh()")
    await tab.run(press.format("Give to"))
    await tab.agree()
    await tab.until(f"{TOASTS}.includes('planner: obstacle')")
    given = wire.decode(json.dumps(planner.asked[-1][1]).encode(), swarm.GiveObstacle, "obstacle").obstacle
    assert isinstance(given.what, swarm.NoFly)
    assert len(given.what.polygon) == 3


# Anywhere.


@pytest.mark.asyncio(loop_scope="module")
async def test_a_phone_shows_it_all(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.size(400, 800)
    await tab.click("[data-row=quad1]")
    await tab.until(f"{card('quad1')} !== null")
    assert await tab.run("document.documentElement.scrollWidth") <= 400
    await tab.until("map.map.getSize().x < 400")
    small = await tab.run("[...document.querySelectorAll('#bar button')].filter((e) => e.offsetHeight < 40).length")
    assert small == 0, "buttons for a thumb"


@pytest.mark.asyncio(loop_scope="module")
async def test_a_viewer_gets_no_button_that_acts(tab: Tab, serve: Serve) -> None:
    viewer = serve(Rules(read_only=True))
    viewer.vehicle("quad7", 7)
    await tab.open(f"http://127.0.0.1:{viewer.port}/")
    await pieces(tab)
    await tab.until("document.getElementById('link').textContent.startsWith('live')")
    viewer.vehicle("quad7", 7)
    await tab.until(f"{row('quad7')} !== null")
    await tab.run(f"{row('quad7')}.click()")
    await tab.until(f"{card('quad7')} !== null")
    assert await tab.run("document.getElementById('everybody').hidden")
    await tab.run(
        "drawing.shapes.add('search', [{lat: 0, lon: 0}, {lat: 0, lon: 1}, {lat: 1, lon: 0}]); drawing.refresh()"
    )
    buttons = "document.querySelectorAll('.shapes button, .card button, #goals button')"
    labels = await tab.run(f"[...{buttons}].map((each) => each.textContent)")
    assert set(labels) == {"Copy command", "Delete"}
    assert viewer.post("/swarm/pause", {}).status == 403
