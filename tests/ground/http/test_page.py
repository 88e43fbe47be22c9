"""The gateway's pages in a real browser (Chromium without a window), driven over its DevTools protocol.

https://chromedevtools.github.io/devtools-protocol/
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Iterator
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import pytest_asyncio
import zenoh
from websockets.asyncio.client import ClientConnection, connect

from ground.http.guard import Rules
from zmav import keys, wire
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve, Served

PATIENCE_S = 30.0
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--mute-audio",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
    "--remote-debugging-port=0",
)


class Tab:
    """One page of a browser, and what its console and its errors said."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._session = self._target = ""
        self.said: list[str] = []
        """console messages, uncaught errors and what the page's policy forbade"""
        self._task = asyncio.create_task(self._listen())

    async def open(self, url: str) -> None:
        """Show a page in a new tab, in place of the last one."""
        before, self._session = self._target, ""
        self._target = (await self.call("Target.createTarget", url="about:blank"))["targetId"]
        if before:
            await self.call("Target.closeTarget", targetId=before)
        self.said.clear()
        attached = await self.call("Target.attachToTarget", targetId=self._target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            await self.call(f"{domain}.enable")
        await self.call("Page.navigate", url=url)

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        number = next(self._ids)
        message: dict[str, Any] = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._waiting[number] = asyncio.get_running_loop().create_future()
        await self._connection.send(json.dumps(message))
        answer = await within(2 * PATIENCE_S, _result(self._waiting[number]))
        del self._waiting[number]
        assert "error" not in answer, f"{method}: {answer}"
        result: dict[str, Any] = answer["result"]
        return result

    async def run(self, script: str) -> Any:
        """The value of an expression in the page; promises are awaited."""
        answer = await self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, condition: str) -> Any:
        """Wait in the page itself until an expression is true; its value."""
        script = f"""new Promise((resolve, reject) => {{
            const begin = Date.now();
            const look = () => {{
                let value = null;
                try {{ value = {condition}; }} catch (error) {{ value = null; }}
                if (value) resolve(value);
                else if (Date.now() - begin > {1000 * PATIENCE_S}) resolve(null);
                else setTimeout(look, 50);
            }};
            look();
        }})"""
        value = await self.run(script)
        assert value, f"never came true: {condition}; the page said {self.said}: {await self.text('body')}"
        return value

    async def text(self, selector: str) -> str:
        """The visible text of the first element that fits."""
        return str(await self.run(f"document.querySelector({json.dumps(selector)}).innerText"))

    async def picture(self, path: Path, width: int, height: int, *, dark: bool = False, scale: float = 1.0) -> None:
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        await self.call("Emulation.setEmulatedMedia", features=[scheme])
        await self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=width < 600,
        )
        await self.run("new Promise((resolve) => setTimeout(resolve, 600))")
        shot = await self.call("Page.captureScreenshot", format="png", captureBeyondViewport=False)
        path.write_bytes(base64.b64decode(shot["data"]))

    async def close(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _listen(self) -> None:
        async for text in self._connection:
            message = json.loads(text)
            if (waiting := self._waiting.get(message.get("id"))) is not None:
                waiting.set_result(message)
            elif message.get("method") == "Runtime.consoleAPICalled":
                self.said.append(str(message["params"]["args"]))
            elif message.get("method") == "Runtime.exceptionThrown":
                self.said.append(str(message["params"]["exceptionDetails"]))
            elif message.get("method") == "Log.entryAdded":
                self.said.append(message["params"]["entry"]["text"])


async def _result(future: asyncio.Future[dict[str, Any]]) -> dict[str, Any]:
    return await future


@contextlib.asynccontextmanager
async def browser() -> AsyncIterator[Tab]:
    """A tab of a Chromium of our own, which ends with the ``async with``."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        process = await asyncio.create_subprocess_exec(
            CHROMIUM,
            *FLAGS,
            f"--user-data-dir={home}",
            "about:blank",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        try:
            assert process.stderr is not None
            url = await within(PATIENCE_S, _address(process.stderr))
            async with connect(url, max_size=None) as connection:
                tab = Tab(connection)
                yield tab
                await tab.close()
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()


async def _address(lines: asyncio.StreamReader) -> str:
    while line := await lines.readline():
        if line.startswith(b"DevTools listening on "):
            return line.split()[-1].decode()
    raise AssertionError("Chromium ended without saying where its DevTools listen")


# The pages as they are served.


def test_a_page_is_one_document_with_a_strict_policy(served: Served) -> None:
    for path in ("/", "/docs"):
        reply = served.get(path)
        assert reply.status == 200
        assert reply.headers["content-type"] == "text/html; charset=utf-8"
        policy = reply.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert not re.search(r"<(script|link|img)[^>]+(src|href)=\"(?!data:)", reply.text), "something is not put in"
        assert 'content="{' not in reply.text
        assert len(re.findall("<script>", reply.text)) == policy.partition("script-src")[2].split(";")[0].count(
            "sha256"
        )
    packed = served.request("GET", "/", accept_encoding="gzip")
    assert packed.headers["content-encoding"] == "gzip"
    assert len(packed.body) < len(served.get("/").body) / 2


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


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tab() -> AsyncIterator[Tab]:
    if not CHROMIUM:
        pytest.skip("no Chromium is installed (Debian: chromium)")
    async with browser() as tab:
        yield tab


class Fleet:
    """Vehicles that speak five times a second until told to be silent, and the orders that they got."""

    def __init__(self, served: Served) -> None:
        self._served = served
        self.orders: list[str] = []
        self.height, self.charge = 0.0, 0.9
        self.silent: set[str] = set()
        self._stop = threading.Event()
        self._queryable = served.session.declare_queryable(keys.DO.key("demo", "*", verb="*"), self._on_order)
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._queryable.undeclare()

    def _speak(self) -> None:
        while not self._stop.wait(0.2):
            for number, name in enumerate(("quad1", "quad2"), start=1):
                if name not in self.silent:
                    self._served.session.put(keys.STATE.key("demo", name), wire.encode(self._state(name, number)))

    def _state(self, name: str, number: int) -> wire.VehicleState:
        place = wire.GlobalPosition(lat_deg=-35.3 + number / 1e4, lon_deg=149.1, alt_amsl=600, alt_rel=self.height)
        return wire.VehicleState(
            t=time.time(),
            fleet="demo",
            name=name,
            instance=name,
            connected=True,
            sysid=number,
            compid=1,
            position=place,
            kind="copter",
            autopilot="ardupilot",
            mode="<b>GUIDED</b>",
            armed=number == 1,
            battery=wire.Battery(remaining=self.charge),
        )

    def _on_order(self, query: zenoh.Query) -> None:
        with query:
            key = str(query.key_expr)
            if (order := "/".join(key.split("/")[2:])) not in self.orders:  # one that takes long is asked again
                self.orders.append(order)
            query.reply(key, wire.encode(wire.Outcome(verb=key.rpartition("/")[2], status="done", took=0.1)))


@pytest.fixture(scope="module")
def fleet(served: Served) -> Iterator[Fleet]:
    fleet = Fleet(served)
    yield fleet
    fleet.close()


def card(name: str) -> str:
    return f"document.querySelector('[data-vehicle={name}]')"


def row(name: str) -> str:
    """A vehicle's row in the table."""
    return f"document.querySelector('[data-row={name}]')"


def press(name: str, label: str) -> str:
    """A script that presses a button of a vehicle's card by its label."""
    return f"[...{card(name)}.querySelectorAll('button')].find((each) => each.textContent === '{label}').click()"


async def show(tab: Tab, served: Served) -> None:
    """The page again, once it hears the fleet: a test may be the first of them, or the only one."""
    await tab.open(f"http://127.0.0.1:{served.port}/")
    await tab.until(f"{row('quad1')} !== null && {row('quad2')} !== null")
    await tab.until("document.getElementById('link').textContent.startsWith('live')")
    await tab.run("document.getElementById('select-all').click()")  # the selected have cards
    await tab.until(f"{card('quad1')} !== null && {card('quad2')} !== null")


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
    assert await tab.text("#summary") == "2 vehicles · 1 armed"
    fleet.silent.add("quad2")
    await tab.until(f"{card('quad2')}.classList.contains('stale') && {card('quad2')}.innerText.includes('no word for')")
    assert "1 silent" in await tab.text("#summary")
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
    await tab.run(f"{press('quad1', 'Land')}; {press('quad1', 'Land?')}")  # at once: the second must come in time
    await tab.until("document.getElementById('toasts').innerText.includes('quad1: land done')")
    await tab.run(press("quad2", "Hold"))
    await tab.until("document.getElementById('toasts').innerText.includes('quad2: hold done')")
    await tab.run(press("quad2", "Arm…"))
    await tab.until("document.getElementById('confirm').open")
    yes = "document.getElementById('confirm-yes').click()"
    no = "document.querySelector('#confirm button[value=no]').click()"
    await tab.run(f"{no}; {press('quad2', 'Take off…')}; {yes}")  # the yes is to the second question, and to no other
    await tab.until("document.getElementById('toasts').innerText.includes('quad2: takeoff done')")
    assert fleet.orders == ["quad1/do/land", "quad2/do/hold", "quad2/do/takeoff"]


@pytest.mark.asyncio(loop_scope="module")
async def test_a_lost_connection_is_unmistakable(tab: Tab, serve: Serve) -> None:
    """A page of a gateway that only reads and asks for a token, and then ends."""
    guarded = serve(Rules(token="secret", read_only=True))
    guarded.vehicle("quad5", 5)
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
