"""The gateway's pages in a real browser."""

from __future__ import annotations

import asyncio
import re
import time
from importlib import resources
from typing import TYPE_CHECKING

import pytest

from ground.http.guard import Rules
from tests.ground.http.browser import READ_S, Fleet, Tab, button, card, press, row, show
from zmav import keys, wire

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

# The pages as they are served.


def test_a_page_runs_what_is_served_with_it_and_nothing_else(served: Served) -> None:
    for path in ("/", "/docs"):
        reply = served.get(path)
        assert reply.status == 200
        assert reply.headers["content-type"] == "text/html; charset=utf-8"
        policy = reply.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self'" in policy
        assert "unsafe" not in policy
        linked = re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=\"(?!data:)([^\"]+)", reply.text)
        assert linked
        for each in linked:
            assert each.startswith("static/"), "something from elsewhere"
            found = served.get(f"/{each}")
            assert (found.status, found.headers["x-content-type-options"]) == (200, "nosniff"), each
        assert "<style" not in reply.text
        assert not re.search(r"<script[^>]*>[^<]", reply.text), "something that the policy forbids"
        assert 'content="{' not in reply.text
    packed = served.request("GET", "/", accept_encoding="gzip")
    assert packed.headers["content-encoding"] == "gzip"
    assert len(packed.body) < len(served.get("/").body) / 2


def test_what_a_browser_has_is_not_sent_again(served: Served) -> None:
    first = served.get("/static/main.js")
    assert first.headers["content-type"] == "text/javascript; charset=utf-8"
    again = served.request("GET", "/static/main.js", if_none_match=first.headers["etag"])
    assert (again.status, again.body) == (304, b"")
    for name in ("nosuch.js", "index.html", "../page.py", "vendor/leaflet.LICENSE", ""):
        assert served.get(f"/static/{name}").status == 404, name


def test_nothing_on_the_pages_is_made_of_markup() -> None:
    """What vehicles say is put in as text only."""
    folder = resources.files("ground.http").joinpath("static")
    scripts = [each for each in folder.iterdir() if each.name.endswith(".js")]
    assert len(scripts) > 5
    for each in scripts:
        text = each.read_text(encoding="utf-8")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function", text), (
            each
        )
        assert "</script" not in text


# In a browser.


@pytest.mark.asyncio(loop_scope="module")
async def test_the_page_shows_the_fleet_move(tab: Tab, served: Served, fleet: Fleet) -> None:
    await show(tab, served)
    fleet.height = 12.3
    await tab.until(f"{card('quad1')}.innerText.includes('12.3 m')")
    shown = await tab.text("[data-vehicle=quad1]")
    assert "<b>GUIDED</b>" in shown, "what a vehicle says is text and not markup"
    assert "ARMED" in shown
    assert "battery 0%" not in shown
    fleet.charge = 0.0
    await tab.until(f"{card('quad1')}.innerText.includes('battery 0%')")
    assert await tab.run(f"{card('quad1')}.classList.contains('trouble')")
    fleet.charge = 0.9
    await tab.until(f"!{card('quad1')}.innerText.includes('battery 0%')")
    assert "-35.299900, 149.100000" in shown
    await tab.until("document.getElementById('summary').textContent === '2 vehicles · 1 armed'")
    fleet.silent.add("quad2")
    await tab.until(f"{card('quad2')}.classList.contains('stale') && {card('quad2')}.innerText.includes('no word for')")
    await tab.until("document.getElementById('summary').textContent.includes('1 silent')")
    fleet.silent.clear()
    await tab.until(f"!{card('quad2')}.classList.contains('stale')")
    assert not tab.said, "errors, or something that the page's own policy forbids"


@pytest.mark.asyncio(loop_scope="module")
async def test_a_broken_vehicle_spoils_its_own_card_only(tab: Tab, served: Served, fleet: Fleet) -> None:
    await show(tab, served)
    for number, state in enumerate(
        (b'{"mode": 5}', b'{"position": {"lat_deg": "x"}, "not_ready": 7}', b"[]", b"7", b"{"), 1
    ):
        served.session.put(keys.STATE.key("demo", f"wreck{number}"), state)
    await tab.until(f"{row('wreck2')} !== null")
    await tab.run("document.getElementById('select-all').click()")
    await tab.until(f"{card('wreck2')}.innerText.includes('not understood')")
    fleet.height = 45.6
    await tab.until(f"{card('quad1')}.innerText.includes('45.6 m')")
    await tab.until("document.getElementById('map-note').textContent.includes('a square is')")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_any_key_expression_is_read_live(tab: Tab, served: Served, fleet: Fleet) -> None:
    await show(tab, served)
    await tab.run("document.getElementById('key').value = 'quad*/ATTITUDE'")
    await tab.run("document.getElementById('subscribe').requestSubmit()")
    await tab.until("document.querySelectorAll('#subscriptions li').length === 1")
    served.hear("ATTITUDE", roll=0.5, time_boot_ms=1, pitch=0, yaw=0, rollspeed=0, pitchspeed=0, yawspeed=0)
    await tab.until(
        "document.querySelector('.value') && document.querySelector('.value').innerText.includes('0.5 rad')"
    )
    assert "zmav/demo/quad1/mav/rx/1/1/ATTITUDE" in await tab.text(".value summary")
    event = wire.Event(t=time.time(), kind="statustext", severity="critical", text="<i>EKF</i> variance")
    served.session.put(keys.EVENT.key("demo", "quad1"), wire.encode(event))
    await tab.until("document.getElementById('events').innerText.includes('<i>EKF</i> variance')")
    await tab.run("document.getElementById('key').value = 'quad1//'")
    await tab.run("document.getElementById('subscribe').requestSubmit()")
    await tab.until("document.getElementById('trouble').textContent.includes('not a key expression')")
    await tab.run("document.querySelector('#subscriptions button').click()")
    await tab.until("document.querySelectorAll('.value').length === 0")
    assert not tab.said


@pytest.mark.asyncio(loop_scope="module")
async def test_orders_are_confirmed_and_their_end_is_said(tab: Tab, served: Served, fleet: Fleet) -> None:
    await show(tab, served)
    fleet.orders.clear()
    await tab.press_twice(button("quad1", "Land"))  # in one go: the second must come in time
    await tab.until("document.getElementById('toasts').innerText.includes('quad1: land done')")
    await tab.run(press("quad2", "Hold"))
    await tab.until("document.getElementById('toasts').innerText.includes('quad2: hold done')")
    await tab.run(press("quad2", "Arm…"))
    await tab.until("document.getElementById('confirm').open")
    yes = "document.getElementById('confirm-yes').click()"
    no = "document.querySelector('#confirm button[value=no]').click()"
    await tab.run(f"{no}; {press('quad2', 'Take off…')}; {yes}")  # at once: to a question that nobody can have read
    await asyncio.sleep(READ_S)
    await tab.run(yes)  # to the second question, and to no other
    await tab.until("document.getElementById('toasts').innerText.includes('quad2: takeoff done')")
    assert fleet.orders == ["quad1/do/land", "quad2/do/hold", "quad2/do/takeoff"]


@pytest.mark.asyncio(loop_scope="module")
async def test_a_lost_connection_is_unmistakable(tab: Tab, serve: Serve) -> None:
    """A page of a gateway that only reads and asks for a token, and then ends."""
    guarded = serve(Rules(token="secret", read_only=True))
    guarded.vehicle("quad5", 5)
    assert guarded.get("/").status == 401
    assert guarded.get("/static/main.js").status == 200, "modules import each other without it"
    await tab.open(f"http://127.0.0.1:{guarded.port}/?token=secret")
    await tab.until("document.getElementById('link').textContent.startsWith('live')")
    guarded.vehicle("quad5", 5)
    await tab.until(f"{row('quad5')} !== null")
    await tab.run(f"{row('quad5')}.click()")
    await tab.until("document.querySelectorAll('article.card').length === 1")
    assert await tab.run("document.querySelectorAll('.card button').length") == 0, "orders that would be refused"
    assert await tab.run("document.getElementById('everybody').hidden")
    assert not tab.said
    await asyncio.to_thread(guarded.close)
    serve.running.remove(guarded)
    await tab.until("!document.getElementById('lost').hidden && document.body.classList.contains('lost')")
    assert "Connection to the gateway lost" in await tab.text("#lost")
    guarded.session.close()


@pytest.mark.asyncio(loop_scope="module")
async def test_the_interface_is_described_and_tried(tab: Tab, served: Served) -> None:
    await tab.open(f"http://127.0.0.1:{served.port}/docs")
    await tab.until("document.querySelectorAll('details').length > 40")
    assert "climb to alt_rel metres above home" in await tab.text("body")
    found = "[...document.querySelectorAll('details')].find((each) => each.innerText.includes('/metrics'))"
    await tab.run(f"{found}.querySelector('button').click()")
    await tab.until(f"{found}.querySelector('pre').textContent.includes('zmav_vehicle_up')")
    assert not tab.said
