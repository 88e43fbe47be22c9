"""The map's side view, what is planned in time, links and headings, by the pointer."""

from __future__ import annotations

import asyncio
import json
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from tests.ground.http.browser import READ_S, FakePlanner, Fleet, Tab
from tests.ground.http.test_operator import TOASTS, at, bar, on_map, opened
from zmav import keys, wire
from zmav.wire import swarm

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served


def high(north: float, east: float, height: float, **more: Any) -> dict[str, Any]:
    state = at(north, east, **more)
    state["local"] = (north, east, -height)
    return state


@pytest.mark.asyncio(loop_scope="module")
async def test_heights_are_seen_from_the_side(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": high(0, 0, 12), "quad2": high(0, 40, 31)}
    await opened(tab, served)
    tall = await tab.run("map.map.getSize().y")
    await tab.click("#heights-button")
    await tab.until("!heights.canvas.hidden && heights.marks.length === 2")
    assert await tab.run("map.map.getSize().y") < tall, "the map makes room"
    low, up = sorted(await tab.run("heights.marks"), key=lambda mark: str(mark["name"]))
    assert (low["height"], up["height"]) == (pytest.approx(12), pytest.approx(31))
    area = await tab.run("(({left}) => left)(map.element.getBoundingClientRect())")
    for name, mark in (("quad1", low), ("quad2", up)):
        assert area + mark["x"] == pytest.approx((await on_map(tab, name))[0], abs=1.5), "each is below its mark"
    assert await tab.run("heights.y(31) < heights.y(12) && heights.y(12) < heights.y(0)")
    drawn = f"heights.ink.getImageData({up['x']}, heights.y(31), 1, 1).data[3]"
    assert await tab.run(drawn) == 255, "something is drawn there"
    fleet.more["quad1"] = high(0, 0, 25)
    await tab.until("heights.marks.find((each) => each.name === 'quad1').height === 25")
    await tab.until("store.named('quad1').trail.length > 1 && store.named('quad1').trail.some((p) => p.alt === 12)")
    assert "2 vehicles, up to" in await tab.run("heights.canvas.getAttribute('aria-label')")
    await tab.click("#heights-button")
    assert await tab.run(f"heights.canvas.hidden && map.map.getSize().y === {tall}")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_planned_way_is_gone_through_in_time(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.until("store.planner && store.origin")
    assert await tab.run("document.getElementById('scrub').hidden"), "nothing is planned"
    await tab.click("[data-row=quad1]")
    await tab.run(f"{bar('Go here')}.click()")
    await tab.click(await on_map(tab, "quad1", 10, -5))
    await tab.until("document.getElementById('confirm').open && !document.getElementById('scrub').hidden")
    left, top, right, bottom = await tab.run(
        "(({left, top, right, bottom}) => [left, top, right, bottom])(byId('scrub-time').getBoundingClientRect())"
    )
    middle = (top + bottom) / 2
    await tab.drag((left + 8, middle), ((left + right) / 2, middle))
    await tab.until("scrubber.ghosts.length === 1")
    chosen = float(await tab.run("byId('scrub-time').value"))
    assert 2.0 < chosen < 4.0, "about half of six seconds"
    north, east = await tab.run("toNed(store.origin, scrubber.ghosts[0].place)")
    assert (north, east) == (pytest.approx(30 * chosen / 6, abs=0.1), pytest.approx(20 * chosen / 6, abs=0.1))
    assert "of 6.0 s" in await tab.text("#scrub-words")
    assert await tab.run("document.querySelectorAll('path.ghost').length") == 1
    await tab.run("byId('scrub-time').focus()")
    await tab.key("ArrowRight")
    assert float(await tab.run("byId('scrub-time').value")) > chosen, "by keys, too"
    fleet.orders.clear()
    await tab.click("[data-verb=hold]")
    await tab.until(f"{TOASTS}.includes('quad1: hold done')")
    assert fleet.orders == ["quad1/do/hold"], "no question delays a hold"
    assert await tab.run("document.getElementById('confirm').open")
    await tab.run(f"{bar('Mode')}.click()")
    await tab.until(f"{TOASTS}.includes('answer this one first')")
    assert await tab.run("document.activeElement.closest('dialog').id") == "confirm"
    await tab.key("Escape")
    await tab.until("!document.getElementById('confirm').open && document.getElementById('scrub').hidden")
    assert await tab.run("scrubber.ghosts.length") == 0
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_marks_tell_kind_colour_and_heading_and_follow(tab: Tab, served: Served, fleet: Fleet) -> None:
    yaw = wire.Attitude(roll=0.0, pitch=0.0, yaw=1.0)
    fleet.more = {"quad1": at(0, 0, attitude=yaw), "quad2": at(0, 20, kind="rover")}
    await opened(tab, served)
    await tab.until("document.querySelectorAll('.craft svg').length >= 2")
    drawn = await tab.run("""['quad1', 'quad2'].map((name) => {
        const path = document.querySelector(`.craft[title=${name}] path`);
        return [path.getAttribute('d'), path.getAttribute('fill'), path.closest('svg').style.transform];
    })""")
    assert drawn[0][0] != drawn[1][0], "a rover has another outline"
    assert drawn[0][1] != drawn[1][1]
    assert drawn[0][2] == "rotate(1rad)"
    await tab.click("#follow")
    await tab.until("document.getElementById('follow').getAttribute('aria-pressed') === 'true'")
    fleet.more["quad2"] = at(900, 900, kind="rover")
    await tab.until("map.map.getBounds().contains([store.named('quad2').place.lat, store.named('quad2').place.lon])")
    assert await tab.run(
        "map.map.getBounds().contains([store.named('quad1').place.lat, store.named('quad1').place.lon])"
    )
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_links_have_the_colour_of_their_quality(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    line = "fleetLayer.lines.get('quad1 quad2')"
    # One process has one router: what /report would say of two is put in its place.
    await tab.run("Object.defineProperty(store, 'links', {get: () => window.said, set: () => {}}); window.said = []")
    for grade, colour in (("good", "--good"), ("fair", "--warn"), ("poor", "--bad"), ("down", "--bad")):
        await tab.run(f"window.said = [{{a: 'quad1', b: 'quad2', grade: '{grade}', loss: 0, rtt: 0}}]")
        dashed = "" if grade == "down" else "!"
        await tab.until(f"{line}.options.color === map.colour('{colour}') && {dashed}{line}.options.dashArray")
    await tab.click("#show-links")
    await tab.until(f"{line} === undefined")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_what_is_flown_goes_with_the_time(tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    goal = swarm.GoTo(vehicles=["quad1"], to=[(0.0, 50.0, -10.0)])
    planner.goals = [swarm.GoalEntry(id="g7", goal=goal, state="flying", t=time.time(), progress=0.1)]
    await opened(tab, served)
    await tab.until("store.openGoals.length === 1 && store.origin")
    start = time.time() - 5.0
    plan = swarm.PlanReport(
        t=start,
        planner="base",
        goal="g7",
        start=start,
        makespan=100.0,
        clearance=None,
        tracks={"quad1": [(0.0, 0.0, 0.0, -10.0), (100.0, 0.0, 50.0, -30.0)]},
    )
    served.session.put(keys.FLEET.key("demo", topic="plan"), wire.encode(plan))
    await tab.until("!byId('scrub').hidden && Number(byId('scrub-time').value) >= 5")
    first = float(await tab.run("byId('scrub-time').value"))
    await tab.until(f"Number(byId('scrub-time').value) > {first + 0.5}")
    assert await tab.run("scrubber.ghosts.length === 0 && byId('scrub-now').hidden")
    await tab.click("#scrub-time")
    await tab.until("scrubber.ghosts.length === 1")
    share = float(await tab.run("byId('scrub-time').value")) / 100.0
    assert share == pytest.approx(0.5, abs=0.02)
    ghost = await tab.run("({height: scrubber.ghosts[0].height, at: toNed(store.origin, scrubber.ghosts[0].place)})")
    assert ghost["height"] == pytest.approx(10.0 + 20.0 * share, abs=0.01)
    assert ghost["at"][1] == pytest.approx(50.0 * share, abs=0.1)
    assert f"quad1 {10 + 20 * share:.0f} m" in await tab.text(".leaflet-tooltip-pane")
    await tab.click("#scrub-now")
    await tab.until("scrubber.ghosts.length === 0 && Number(byId('scrub-time').value) < 40")
    stop = "[...document.querySelectorAll('#goals button')].find((each) => each.textContent.startsWith('Stop'))"
    await tab.run(f"{stop}.click()")
    planner.goals = [msgspec.structs.replace(planner.goals[0], progress=0.2)]
    await tab.until("document.querySelector('#goals progress').value === 0.2")
    await asyncio.sleep(READ_S)
    await tab.run(f"{stop}.click()")  # the second press, although the goal has come further
    await tab.until("store.openGoals.length === 0")
    assert planner.asked[-1] == ("cancel", planner.asked[-1][1] | {"goal": "g7"})
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_a_vehicle_s_name_keeps_off_those_of_areas(tab: Tab, served: Served, fleet: Fleet) -> None:
    """An area's first corner, above which its name stands, is drawn where the vehicle's own name is."""
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    own = "[...document.querySelectorAll('.label')].find((each) => each.textContent.startsWith('quad1'))"
    edges = "(({left, top, right, bottom}) => [left, top, right, bottom])(each.getBoundingClientRect())"
    box = f"((each) => each && !each.hidden && {edges})"
    await tab.until(f"{box}({own})")
    await tab.run(f"""(() => {{
        const [left, top, right, bottom] = {box}({own}), frame = document.getElementById('map').getBoundingClientRect();
        const place = (x, y) => {{
            const at = map.map.containerPointToLatLng([(left + right) / 2 - frame.left + x, bottom - frame.top + y]);
            return {{lat: at.lat, lon: at.lng}};
        }};
        drawing.shapes.add('search', [place(0, 8), place(90, 8), place(90, 90), place(0, 90)]);
        drawing.refresh();
    }})()""")
    await tab.until("document.querySelector('.leaflet-tooltip.named')")
    await asyncio.sleep(0.6)  # drawn five times a second
    a, b = await tab.run(f"[{box}({own}), {box}(document.querySelector('.leaflet-tooltip.named'))]")
    assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1], (a, b)
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_the_map_stands_still_under_a_tool_and_under_what_is_dragged(
    tab: Tab, served: Served, fleet: Fleet
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.run("map.follow(true); drawing.editing = drawing.shapes.add('obstacle', map.placesShown.slice(0, 1)).id")
    await tab.run("drawing.refresh()")
    view = "`${map.map.getCenter()} ${map.map.getZoom()}`"
    before = await tab.run(view)
    await tab.click("#measure")
    fleet.more["quad2"] = at(0, 3000)
    await tab.until("!map.holds(map.placesShown)")
    await asyncio.sleep(0.5)  # drawn five times a second
    assert await tab.run(view) == before, "what is clicked next is where it was"
    await tab.key("Escape")
    await tab.until("map.holds(map.placesShown)")
    there = await on_map(tab, "quad1")
    await tab.mouse("mouseMoved", *there)
    await tab.mouse("mousePressed", *there, held=True)
    await tab.mouse("mouseMoved", there[0] + 30, there[1], held=True)
    before = await tab.run(view)
    fleet.more["quad2"] = at(3000, 30000)
    await tab.until("!map.holds(map.placesShown)")
    await asyncio.sleep(0.5)  # drawn five times a second
    assert await tab.run(view) == before
    await tab.mouse("mouseReleased", there[0] + 30, there[1])
    await tab.until("map.holds(map.placesShown)")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_places_are_about_the_origin_that_the_fleet_was_started_again_with(
    tab: Tab, served: Served, fleet: Fleet
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    about = "store.origin && toNed(store.origin, store.named('quad1').place)"
    await tab.until(f"Math.hypot(...{about}) < 1")
    for north in (700.0, 703.0):
        fleet.more = {"quad1": at(0, 0, local=(north, 0.0, -10.0)), "quad2": at(0, 40, local=(north, 40.0, -10.0))}
        await tab.until(f"Math.abs(({about})[0] - {north}) < 1")
    fleet.silent.add("quad1")
    fleet.more["quad2"] = at(0, 40, local=(1400.0, 40.0, -10.0))
    await tab.until(f"Math.abs(({about})[0] - 1400) < 1")
    assert not tab.said


ORIGINS = """(() => {
  const other = new store.constructor(), found = [], first = { lat: 47, lon: 8 };
  const say = (name, north, local) => other.take({ key: `zmav/demo/${name}/state`, value: {
    position: { lat_deg: toGlobal(first, north, 0).lat, lon_deg: 8, alt_rel: 10 }, local: [local, 0, -10] } });
  say("a", 0, 0);
  say("b", 5, 5);
  for (const silent of ["", "a", "b"]) {
    if (silent) other.vehicles.get(`demo/${silent}`).at = 0;
    say("c", 0, 700);
    found.push(Math.round(toNed(first, other.origin)[0]));
  }
  return found;
})()"""


@pytest.mark.asyncio(loop_scope="module")
async def test_one_vehicle_that_has_another_origin_moves_nobodys_while_one_is_heard(tab: Tab, served: Served) -> None:
    await opened(tab, served)
    assert await tab.run(ORIGINS) == [0, 0, -700]


@pytest.mark.asyncio(loop_scope="module")
async def test_an_area_has_its_name_where_the_planners_cannot_be_drawn(tab: Tab, served: Served, fleet: Fleet) -> None:
    await opened(tab, served)
    await tab.until("store.all.every((each) => !each.state.local)")
    await tab.run("store.origin = null")  # what the gateway kept of a vehicle may have told one
    corners = "[[5, 5], [5, 30], [-15, 30]].map(([n, e]) => toGlobal(store.named('quad1').place, n, e))"
    name = await tab.run(f"drawing.shapes.add('no_fly', {corners}).name")
    area = swarm.NoFly(polygon=[(0.0, 0.0), (0.0, 9.0), (9.0, 0.0)], floor=0.0, ceiling=9.0)
    kept = swarm.Obstacle(name=name, t=time.time(), what=area)
    served.session.put(keys.OBSTACLE.key("demo", name=name), wire.encode(kept))
    await tab.until(f"store.obstacles.has('{name}')")
    await tab.run("drawing.refresh()")
    named = "[...document.querySelectorAll('.named')].filter((each) => each.textContent === '%s').length"
    assert await tab.run(named % name) == 1
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_an_area_that_was_just_given_is_dragged_to_the_end(
    tab: Tab, served: Served, fleet: Fleet, planner: FakePlanner
) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 40)}
    await opened(tab, served)
    await tab.until("store.planner && store.origin")
    corners = "[[5, 5], [5, 30], [-15, 30]].map(([n, e]) => toGlobal(store.named('quad1').place, n, e))"
    await tab.run(
        f"showTab('drawing'); drawing.editing = drawing.shapes.add('no_fly', {corners}).id; drawing.refresh()"
    )
    press = "[...document.querySelectorAll('.shapes button')].find((each) => each.textContent.startsWith('Give'))"
    await tab.run(f"{press}.click()")
    await tab.agree()
    await tab.until(f"{TOASTS}.includes('planner: obstacle')")
    start, end = await on_map(tab, "quad1", -15, 30), await on_map(tab, "quad1", -25, 30)
    await tab.mouse("mouseMoved", *start)
    await tab.mouse("mousePressed", *start, held=True)
    await tab.mouse("mouseMoved", start[0], (start[1] + end[1]) / 2, held=True)
    served.session.put(keys.OBSTACLE.key("demo", name="nofly1"), json.dumps(planner.asked[-1][1]["obstacle"]))
    named = "[...document.querySelectorAll('.named')].filter((each) => each.textContent === 'nofly1').length"
    await tab.until("plans.shapes.getLayers().length === 1")
    await asyncio.sleep(1.8)  # the planner has said by now what it keeps clear of
    assert await tab.run(named) == 1, "its name stands there once"
    await tab.mouse("mouseMoved", *end, held=True)
    await tab.mouse("mouseReleased", *end)
    north = await tab.run("toNed(store.named('quad1').place, drawing.shapes.all[0].points[2])[0]")
    assert north == pytest.approx(-25, abs=1)
    served.session.put(keys.OBSTACLE.key("demo", name="nofly1"), b'{"name": "nofly1", "t": 1.0, "what": null}')
    assert not tab.said
