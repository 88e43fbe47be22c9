"""The page without a pointer, in the sun, and for who does not see it or does not look at it."""

from __future__ import annotations

import asyncio
import re
from typing import TYPE_CHECKING

import pytest

from tests.ground.http.browser import READ_S, Fleet, Tab, card
from tests.ground.http.test_operator import TOASTS, at, opened, selected
from zmav import wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

HOLDS_WORDS = (
    "button",
    "checkbox",
    "textbox",
    "searchbox",
    "combobox",
    "spinbutton",
    "slider",
    "tab",
    "link",
    "dialog",
)
FOCUSED = "document.activeElement"


async def walk(tab: Tab, wanted: str, most: int = 90) -> None:
    """Go on with the tab key until what is focused is so."""
    for _ in range(most):
        await tab.key("Tab")
        if await tab.run(f"Boolean({wanted})"):
            return
    raise AssertionError(f"no tab key leads to {wanted}")


# Keys alone.


@pytest.mark.asyncio(loop_scope="module")
async def test_a_vehicle_is_selected_held_and_sent_by_keys_alone(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await walk(tab, f"{FOCUSED}.dataset.row === 'quad1'")
    await tab.key("ArrowDown")
    assert await tab.run(f"{FOCUSED}.dataset.row") == "quad2"
    await tab.key("Enter")
    assert await selected(tab) == ["quad2"]
    await tab.key("ArrowUp")
    await tab.key(" ")
    assert await selected(tab) == ["quad1", "quad2"]
    await tab.key(" ")
    assert await selected(tab) == ["quad2"]
    fleet.orders.clear()
    fleet.asked.clear()
    await walk(tab, f"{FOCUSED}.dataset.verb === 'hold'")
    await tab.key("Enter")
    await tab.until(f"{TOASTS}.includes('quad2: hold done')")
    await walk(tab, f"{FOCUSED}.dataset.tool === 'go'")
    await tab.key("Enter")
    await tab.until(f"{FOCUSED} === map.element && !document.querySelector('.crosshair').hidden")
    assert "space bar" in await tab.text("#map-tool")
    before = await tab.run("map.map.getCenter().lat")
    await tab.key("ArrowUp")
    await tab.until(f"map.map.getCenter().lat > {before} && !map.map._panAnim?._inProgress")
    lat = await tab.run("map.map.getCenter().lat")
    await tab.key(" ")
    await tab.until("document.getElementById('confirm').open")
    await asyncio.sleep(READ_S)
    await tab.key("Enter")
    await tab.until(f"{TOASTS}.includes('quad2: goto done')")
    assert fleet.asked[fleet.orders.index("quad2/do/goto")]["lat_deg"] == pytest.approx(lat, abs=1e-5)
    await tab.key("Escape")
    assert await selected(tab) == []
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_an_area_is_drawn_and_moved_by_keys_alone(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await walk(tab, f"{FOCUSED}.dataset.tab === 'alarms'")
    for _ in range(3):
        await tab.key("ArrowRight")
    await tab.until("!document.getElementById('drawing').hidden")
    await walk(tab, f"{FOCUSED}.dataset.tool === 'geofence'")
    await tab.key("Enter")
    for way in ("ArrowUp", "ArrowRight", "ArrowDown"):
        await tab.key(" ")
        await tab.key(way)
        await tab.until("!map.map._panAnim?._inProgress")
    await tab.key("Enter")
    await tab.until("drawing.shapes.all.length === 1 && drawing.shapes.all[0].points.length === 3")
    await tab.run("document.querySelector('.corner').focus()")
    before = await tab.run("drawing.shapes.all[0].points[0].lon")
    await tab.key("ArrowRight")
    await tab.key("ArrowRight")
    await tab.until(f"drawing.shapes.past.length === 3 && drawing.shapes.all[0].points[0].lon > {before}")
    assert await tab.run(f"{FOCUSED}.classList.contains('corner')"), "the focus stays on the corner"
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_the_keys_are_listed(tab: Tab, served: Served, fleet: Fleet) -> None:
    await opened(tab, served)
    await tab.key("?", shift=True)
    await tab.until("document.getElementById('keys').open")
    assert "select all that are shown" in await tab.text("#keys")
    await tab.key("Escape")
    await tab.until("!document.getElementById('keys').open")


# What a screen reader says.


@pytest.mark.asyncio(loop_scope="module")
async def test_all_that_can_be_used_has_a_name(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0, battery=wire.Battery(remaining=0.05)), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.run("document.getElementById('select-all').click(); document.getElementById('heights-button').click()")
    await tab.run("drawing.shapes.add('obstacle', [store.all[0].place]); drawing.editing = 1; drawing.refresh()")
    await tab.until(f"{card('quad1')} !== null")
    for name in ("alarms", "goals", "preflight", "drawing", "happened"):
        await tab.run(f"showTab('{name}')")
        tree = (await tab.call("Accessibility.getFullAXTree"))["nodes"]
        shown = [each for each in tree if not each["ignored"]]
        found = [(each["role"]["value"], each.get("name", {}).get("value", "").strip()) for each in shown]
        assert len(found) > 100
        nameless = {(role, text) for role, text in found if role in HOLDS_WORDS and not re.search(r"[\w?×+−]", text)}
        assert not nameless, name
        bare = [text for role, text in found if role in ("button", "checkbox") and text in ("×", "+", "−", "on")]
        assert not bare, "a sign is no name"
    roles = {role for role, _ in found}
    assert {"main", "table", "tablist", "tabpanel", "status", "toolbar", "application"} <= roles
    texts = " ".join(text for _, text in found)
    assert "quad1, GUIDED, act now" in texts, "a mark on the map says who it is and how"
    assert "select quad1" in texts
    await tab.run("document.getElementById('heights-button').click()")


# In the sun, and in the dark.

CONTRAST = """(() => {
    const channel = (value) => (value <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
    const ink = document.createElement('canvas').getContext('2d');
    const light = (name) => {
        ink.fillStyle = map.colour(name);
        ink.fillRect(0, 0, 1, 1);
        const [r, g, b] = [...ink.getImageData(0, 0, 1, 1).data].map((each) => channel(each / 255));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const found = {};
    for (const front of ['--text', '--muted', '--accent', '--good', '--warn', '--bad'])
        for (const back of ['--bg', '--panel', '--tint']) {
            const [a, b] = [light(front), light(back)].sort((x, y) => y - x);
            found[`${front} on ${back}`] = (a + 0.05) / (b + 0.05);
        }
    return found;
})()"""
"""WCAG 2.2, contrast ratio: https://www.w3.org/TR/WCAG22/#dfn-contrast-ratio"""


@pytest.mark.asyncio(loop_scope="module")
async def test_it_is_readable_in_the_sun_and_in_the_dark(tab: Tab, served: Served, fleet: Fleet) -> None:
    await opened(tab, served)
    for name, least in (("contrast", 7.0), ("light", 4.5), ("dark", 4.5)):
        await tab.run(f"""(() => {{
            const select = document.getElementById('theme');
            select.value = '{name}';
            select.dispatchEvent(new Event('change'));
        }})()""")
        assert await tab.run("document.documentElement.dataset.theme") == name
        ratios = await tab.run(CONTRAST)
        assert len(ratios) == 18
        below = {pair: ratio for pair, ratio in ratios.items() if ratio < least}
        assert not below, name
    await tab.run("localStorage.setItem('zmav theme', '\"contrast\"')")
    await opened(tab, served)
    assert await tab.run("document.documentElement.dataset.theme") == "contrast", "it is kept"


@pytest.mark.asyncio(loop_scope="module")
async def test_the_system_chooses_where_nobody_did(tab: Tab, served: Served, fleet: Fleet) -> None:
    await opened(tab, served)
    theme = "document.documentElement.dataset.theme"
    for scheme, contrast, wanted in (
        ("dark", "no-preference", "dark"),
        ("light", "more", "contrast"),
        ("light", "", "light"),
    ):
        features = [{"name": "prefers-color-scheme", "value": scheme}, {"name": "prefers-contrast", "value": contrast}]
        await tab.call("Emulation.setEmulatedMedia", features=features)
        await tab.run("localStorage.clear()")
        await tab.until(f"{theme} === '{wanted}'")
    await tab.call("Emulation.setEmulatedMedia", features=[])


# Alarms to hear.


@pytest.mark.asyncio(loop_scope="module")
async def test_alarms_are_spoken_or_a_tone_until_seen(tab: Tab, served: Served, fleet: Fleet) -> None:
    fleet.more = {"quad1": at(0, 0), "quad2": at(0, 20)}
    await opened(tab, served)
    await tab.click("#fit")  # a browser gives a page no voice before somebody used it
    await tab.run("""(() => {
        window.spoken = [];
        window.tones = 0;
        speechSynthesis.speak = (words) => spoken.push(words.text);
        const start = OscillatorNode.prototype.start;
        OscillatorNode.prototype.start = function (...when) { window.tones++; return start.apply(this, when); };
    })()""")
    fleet.more["quad2"]["battery"] = wire.Battery(remaining=0.05)
    alarm = "[...document.querySelectorAll('.alarms li')].find((each) => each.innerText.includes('battery 5%'))"
    await tab.until(f"{alarm} !== undefined")
    assert await tab.run("spoken.length + tones") == 0, "nothing is heard until a person wants it"
    select = "document.getElementById('sound')"
    choose = f"{select}.value = '{{}}'; {select}.dispatchEvent(new Event('change'))"
    await tab.run(choose.format("speech"))
    assert await tab.run("spoken[0]") == "Alarms are heard from now on"
    fleet.more["quad1"]["battery"] = wire.Battery(remaining=0.05)
    await tab.until("spoken.includes('quad1: battery 5%')")
    await tab.run(choose.format("tone"))
    assert await tab.run("tones") == 1
    fleet.more["quad1"]["battery"] = wire.Battery(remaining=0.9)
    await tab.until(
        "[...document.querySelectorAll('.alarms li')].filter((e) => e.innerText.includes('battery')).length < 2"
    )
    fleet.more["quad1"]["battery"] = wire.Battery(remaining=0.05)
    await tab.until("tones === 4")
    first = "[...document.querySelectorAll('.alarms li:not(.seen) button.small')].filter((each) => !each.hidden)"
    await tab.until(f"(() => {{ for (const each of {first}) each.click(); return {first}.length === 0; }})()")
    heard = await tab.run("tones")
    await tab.run("new Promise((resolve) => setTimeout(resolve, 11000))")
    assert await tab.run("tones") == heard, "what was seen is silent"
    await tab.run("localStorage.clear()")
    assert not tab.said
