"""A real browser (Chromium without a window), driven over its DevTools protocol, and a fleet for its pages.

https://chromedevtools.github.io/devtools-protocol/
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import zenoh
from websockets.asyncio.client import ClientConnection, connect

from tests.waiting import wait_until
from zmav import keys, wire
from zmav.waiting import within
from zmav.wire import swarm

if TYPE_CHECKING:
    from tests.ground.http.conftest import Served

PATIENCE_S = 30.0
READ_S = 0.6
"""s in which a person reads what appeared; what is pressed sooner was meant for something else"""
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
    """A browser's tab, and what the console and the errors of its page said. ``target``: its name, if it is there."""

    def __init__(self, connection: ClientConnection, group: int, target: str) -> None:
        self._connection, self.group = connection, group
        """``group``: of the browser's processes"""
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._session, self.target = "", target
        self._origins: set[str] = set()
        """servers of what it showed"""
        self.said: list[str] = []
        """console messages, uncaught errors and what the page's policy forbade"""
        self._task = asyncio.create_task(self._listen())

    async def open(self, url: str, size: tuple[int, int] | None = None) -> None:
        """Show a page, in place of the last one, in a window of that size or of the usual one.

        The tab, and with it the renderer's process, stays: a new one for each page takes the processor longer.
        """
        if self._session:
            await self.clear()
        else:
            self.target = self.target or (await self.call("Target.createTarget", url="about:blank"))["targetId"]
            attached = await self.call("Target.attachToTarget", targetId=self.target, flatten=True)
            self._session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Log"):
                await self.call(f"{domain}.enable")
        if size is not None:
            await self.size(*size)
        self.said.clear()
        self._origins.add("/".join(url.split("/")[:3]))
        await self.call("Page.navigate", url=url)

    async def clear(self) -> None:
        """Show nothing, as a new tab does: the last page has ended, and has said its last word."""
        await self.call("Page.navigate", url="about:blank")
        await self.run("0")  # the renderer answers behind all that it had to tell of the page before
        await self.call("Emulation.clearDeviceMetricsOverride")
        await self.call("Emulation.setEmulatedMedia", features=[])

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

    async def place(self, selector: str) -> tuple[float, float]:
        """The middle of the first element that fits, in the window, where it is brought into view."""
        script = f"""(() => {{
            const element = document.querySelector({json.dumps(selector)});
            element.scrollIntoView({{block: 'nearest', behavior: 'instant'}});
            const area = element.getBoundingClientRect();
            return [area.left + area.width / 2, area.top + area.height / 2];
        }})()"""
        x, y = await self.run(script)
        return x, y

    async def mouse(
        self, kind: str, x: float, y: float, held: bool = False, shift: bool = False, count: int = 1
    ) -> None:
        await self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button="none" if kind == "mouseMoved" and not held else "left",
            buttons=int(held),
            clickCount=count,
            modifiers=8 if shift else 0,
        )

    async def click(self, where: str | tuple[float, float]) -> None:
        """As a person does: the pointer goes there, the button goes down and up."""
        x, y = await self.place(where) if isinstance(where, str) else where
        await self.mouse("mouseMoved", x, y)
        await self.mouse("mousePressed", x, y, held=True)
        await self.mouse("mouseReleased", x, y)

    async def double_click(self, where: str | tuple[float, float]) -> None:
        """Two quick clicks, as a system reports them."""
        x, y = await self.place(where) if isinstance(where, str) else where
        await self.mouse("mouseMoved", x, y)
        for count in (1, 2):
            await self.mouse("mousePressed", x, y, held=True, count=count)
            await self.mouse("mouseReleased", x, y, count=count)

    async def agree(self) -> None:
        """Press yes in the question that is asked, once a person can have read it."""
        await self.until("document.getElementById('confirm').open")
        await asyncio.sleep(READ_S)
        await self.click("#confirm-yes")

    async def press_twice(self, button: str) -> None:
        """A button that asks once more, by a script that finds it: the second time once a person can have read."""
        wait = f"new Promise((resolve) => setTimeout(resolve, {1000 * READ_S}))"
        await self.run(f"(async (button) => {{ button.click(); await {wait}; button.click(); }})({button})")

    async def drag(self, start: tuple[float, float], end: tuple[float, float], shift: bool = False) -> None:
        await self.mouse("mouseMoved", *start, shift=shift)
        await self.mouse("mousePressed", *start, held=True, shift=shift)
        for part in (0.1, 0.5, 1.0):
            x, y = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            await self.mouse("mouseMoved", x, y, held=True, shift=shift)
        await self.mouse("mouseReleased", *end, shift=shift)

    async def key(self, name: str, shift: bool = False) -> None:
        """A key by its DOM name: Escape, Enter, Delete, a."""
        code = {
            "Escape": 27,
            "Enter": 13,
            "Delete": 46,
            "ArrowLeft": 37,
            "ArrowUp": 38,
            "ArrowRight": 39,
            "ArrowDown": 40,
            "Tab": 9,
            " ": 32,
        }.get(name, ord(name[0].upper()))
        text = {"text": "\r"} if name == "Enter" else {"text": name} if len(name) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            await self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=name,
                windowsVirtualKeyCode=code,
                modifiers=8 if shift else 0,
                **text,
            )

    async def size(self, width: int, height: int) -> None:
        """Of the window, as a phone or a screen has it."""
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

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
        """The tab is there still, empty, for who comes next, whose server may have the port of one of now."""
        try:
            if self._session:
                await self.clear()
            for origin in self._origins:
                await self.call("Storage.clearDataForOrigin", origin=origin, storageTypes="all")
        finally:
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


PIECES = ("main", "dom", "geo", "shapes", "tabs", "words")
"""modules of the page whose names are the window's own in tests"""


async def pieces(tab: Tab) -> None:
    """Let scripts use what the page's modules export by its name; the browser has each module once."""
    await tab.until("document.readyState === 'complete'")
    names = json.dumps([f"./static/{name}.js" for name in PIECES])
    await tab.run(f"""Promise.all({names}.map((name) => import(name)))
        .then((found) => {{ for (const each of found) Object.assign(window, each); }})""")


async def _result(future: asyncio.Future[dict[str, Any]]) -> dict[str, Any]:
    return await future


class Chromium:
    """A browser that runs. ``url``: of its DevTools; ``group``: of its processes."""

    def __init__(self, url: str, group: int) -> None:
        self._url, self._group, self._target = url, group, ""

    @contextlib.asynccontextmanager
    async def tab(self) -> AsyncIterator[Tab]:
        """Its one tab, empty. What its pages store is forgotten once it is given back."""
        async with connect(self._url, max_size=None, ping_interval=None) as connection:
            tab = Tab(connection, self._group, self._target)
            try:
                yield tab
            finally:
                self._target = tab.target
                await tab.close()


@contextlib.contextmanager
def chromium(*more: str) -> Iterator[Chromium]:
    """A Chromium of our own, with these flags, too; it ends with the ``with``."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        process = subprocess.Popen(
            [CHROMIUM, *FLAGS, *more, f"--user-data-dir={home}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            told = Path(home) / "DevToolsActivePort"
            wait_until(lambda: told.is_file() and "\n" in told.read_text(), "Chromium does not say where it listens")
            port, path = told.read_text().split()
            yield Chromium(f"ws://127.0.0.1:{port}{path}", process.pid)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextlib.asynccontextmanager
async def browser(*more: str) -> AsyncIterator[Tab]:
    """A tab of such a Chromium; it ends with the ``async with``."""
    with chromium(*more) as started:
        async with started.tab() as tab:
            yield tab


class Fleet:
    """Vehicles that speak five times a second until told to be silent, and the orders that they got."""

    def __init__(self, served: Served) -> None:
        self._served = served
        self.orders: list[str] = []
        self.asked: list[dict[str, Any]] = []
        """the arguments of each"""
        self.results: dict[str, dict[str, Any]] = {}
        """of orders, by verb"""
        self.height, self.charge = 0.0, 0.9
        self.silent: set[str] = set()
        self.names = ["quad1", "quad2"]
        self.more: dict[str, dict[str, Any]] = {}
        """what is otherwise with a vehicle, by its name: fields of its state"""
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
            for number, name in enumerate(tuple(self.names), start=1):
                if name not in self.silent:
                    self._served.session.put(keys.STATE.key("demo", name), wire.encode(self._state(name, number)))

    def _state(self, name: str, number: int) -> wire.VehicleState:
        place = wire.GlobalPosition(lat_deg=-35.3 + number / 1e4, lon_deg=149.1, alt_amsl=600, alt_rel=self.height)
        fields: dict[str, Any] = {
            "t": time.time(),
            "fleet": "demo",
            "name": name,
            "instance": name,
            "connected": True,
            "sysid": number,
            "compid": 1,
            "position": place,
            "kind": "copter",
            "autopilot": "ardupilot",
            "mode": "<b>GUIDED</b>",
            "armed": number == 1,
            "battery": wire.Battery(remaining=self.charge),
        }
        return wire.VehicleState(**fields | self.more.get(name, {}))

    def _on_order(self, query: zenoh.Query) -> None:
        with query:
            key = str(query.key_expr)
            if (order := "/".join(key.split("/")[2:])) not in self.orders:  # one that takes long is asked again
                self.orders.append(order)
                self.asked.append(json.loads(query.payload.to_bytes()) if query.payload else {})
            verb = key.rpartition("/")[2]
            result = self.results.get(verb, {})
            query.reply(key, wire.encode(wire.Outcome(verb=verb, status="done", took=0.1, result=result)))


class FakePlanner:
    """Says that it is in charge, answers what it is asked, and notes it."""

    def __init__(self, served: Served) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.goals: list[swarm.GoalEntry] = []
        self._session = served.session
        self._stop = threading.Event()
        self._queryable = served.session.declare_queryable(keys.SWARM.key("demo", "base", verb="*"), self._on_query)
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def _speak(self) -> None:
        about: dict[str, Any] = {"planner": "base", "instance": "base1", "term": 1}
        while not self._stop.wait(0.2):
            charge, book = swarm.Charge(t=time.time(), **about), swarm.Book(t=time.time(), goals=self.goals, **about)
            self._session.put(keys.FLEET.key("demo", topic="charge"), wire.encode(charge))
            self._session.put(keys.FLEET.key("demo", topic="goal"), wire.encode(book))

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            key, verb = str(query.key_expr), str(query.key_expr).rpartition("/")[2]
            args = json.loads(query.payload.to_bytes()) if query.payload else {}
            self.asked.append((verb, args))
            result: dict[str, Any] = {"goals": [args.get("goal", "")]}
            if verb == "preview":
                tracks = {name: [(0, 0, 0, -10), (6, 30, 20, -10)] for name in args["goal"]["vehicles"]}
                step = {"step": "PlanTo", "text": "", "makespan": 6.0, "clearance": 3.2, "tracks": tracks}
                result = {"makespan": 6.0, "seconds": 9.0, "clearance": 3.2, "steps": [step]}
            elif verb == "submit":
                goal = msgspec.convert(args["goal"], swarm.Goal)
                self.goals = [swarm.GoalEntry(id="g1", goal=goal, state="flying", t=time.time(), progress=0.4)]
                result = {"goal": "g1"}
            elif verb == "cancel":
                self.goals = []
            query.reply(key, wire.encode(wire.Outcome(verb=verb, status="done", took=0.1, result=result)))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._queryable.undeclare()


def card(name: str) -> str:
    return f"document.querySelector('[data-vehicle={name}]')"


def row(name: str) -> str:
    """A vehicle's row in the table."""
    return f"document.querySelector('[data-row={name}]')"


def button(name: str, label: str) -> str:
    """A button of a vehicle's card by its label."""
    return f"[...{card(name)}.querySelectorAll('button')].find((each) => each.textContent === '{label}')"


def press(name: str, label: str) -> str:
    """A script that presses it."""
    return f"{button(name, label)}.click()"


async def show(tab: Tab, served: Served) -> None:
    """The page again, once it hears the fleet: a test may be the first of them, or the only one."""
    await tab.open(f"http://127.0.0.1:{served.port}/")
    await pieces(tab)
    await tab.until(f"{row('quad1')} !== null && {row('quad2')} !== null")
    await tab.until("document.getElementById('link').textContent.startsWith('live')")
    await tab.run("document.getElementById('select-all').click()")  # the selected have cards
    await tab.until(f"{card('quad1')} !== null && {card('quad2')} !== null")
