"""``zmav demo --stay`` flown from the page by a person's pointer and keys: for a test, and for the pictures in docs."""

from __future__ import annotations

import asyncio
import contextlib
import re
import time
from collections.abc import AsyncIterator
from typing import Any

from tests.ground.http.browser import Tab, browser, pieces
from zmav.children import Children
from zmav.process import free_port

WIDE = (1400, 900)
START_S = 120.0
"""s for a demo to start"""
NO_FLY = ((0.47, 0.23), (0.58, 0.23), (0.58, 0.33), (0.47, 0.33))
AREA = ((0.3, 0.08), (0.9, 0.08), (0.86, 0.5), (0.26, 0.5))
"""corners, as shares of the map's width and height"""
Corners = tuple[tuple[float, float], ...]


class Page:
    """The page of a demo that was started just now, in a browser."""

    def __init__(self, tab: Tab, begun: float, router: str = "") -> None:
        self.tab, self._begun, self.router = tab, begun, router

    def say(self, text: str) -> None:
        print(f"[{time.monotonic() - self._begun:6.1f} s] {text}", flush=True)

    async def open(self, port: int) -> None:
        await self.tab.open(f"http://127.0.0.1:{port}/")
        await self.tab.size(*WIDE)
        await pieces(self.tab)

    async def until(self, condition: str, seconds: float = 60.0) -> Any:
        """As the tab's own, which may wait less long."""
        deadline = time.monotonic() + seconds
        while not (value := await self.tab.run(condition)):
            if time.monotonic() > deadline:
                raise TimeoutError(f"never came true: {condition}")
            await asyncio.sleep(0.2)
        return value

    async def press(self, within: str, label: str) -> None:
        """The button whose words begin so."""
        buttons = f"[...document.querySelectorAll('{within} button')]"
        await self.until(f"{buttons}.some((each) => each.textContent.startsWith('{label}') && !each.disabled)")
        mark = f"{buttons}.find((each) => each.textContent.startsWith('{label}')).dataset.pressed = 'next'"
        await self.tab.run(mark)
        await self.tab.click("[data-pressed=next]")
        await self.tab.run("document.querySelectorAll('[data-pressed]').forEach((each) => delete each.dataset.pressed)")

    async def agree(self) -> None:
        await self.tab.agree()
        await self.until("!document.getElementById('confirm').open")

    async def draw(self, tool: str, corners: Corners) -> None:
        await self.tab.click(f"#drawing [data-tool={tool}]")
        frame = "(() => { const r = document.getElementById('map').getBoundingClientRect();"
        left, top, width, height = await self.tab.run(f"{frame} return [r.left, r.top, r.width, r.height]; }})()")
        for x, y in corners:
            await self.tab.click((left + x * width, top + y * height))
        await self.tab.key("Enter")


@contextlib.asynccontextmanager
async def flown_from_the_page(demo: str) -> AsyncIterator[Page]:
    """``zmav demo NAME --stay``, ``zmav http``, and a browser."""
    begun, port, router = time.monotonic(), free_port(), f"tcp/127.0.0.1:{free_port()}"
    with Children(at_once=True, by_signals=True) as processes:
        processes.start("demo", "demo", demo, "--stay", "--endpoint", router)
        await said(processes, "demo", "Ctrl-C", START_S)
        processes.start("http", "http", "--port", str(port), "-e", router)
        await said(processes, "http", "http://", 60.0)
        async with browser() as tab:
            page = Page(tab, begun, router)
            page.say("the page is there")
            await page.open(port)
            yield page


async def said(processes: Children, name: str, words: str, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not any(re.search(re.escape(words), line) for line in processes.lines(name)):
        processes.check()
        if time.monotonic() > deadline:
            raise TimeoutError(f"{name} did not say {words!r}")
        await asyncio.sleep(0.2)


async def take_off(page: Page, count: int, seconds: float) -> None:
    """All, by the planner."""
    await page.until(f"document.querySelectorAll('#rows tr').length === {count}", seconds)
    await page.until("store.planner && store.all.every((each) => each.state.ready)", seconds)
    page.say(f"{count} vehicles and the planner are ready")
    await page.tab.click("#select-all")
    await page.press("#bar", "Take off")
    await page.agree()
    await page.until("store.all.every((each) => each.state.position.alt_rel > 9)", seconds)
    page.say("all are in the air")


async def search(page: Page, no_fly: Corners = NO_FLY, area: Corners = AREA) -> None:
    """Have three take off, draw an area and what is kept clear of in it, and have the area searched."""
    await take_off(page, 3, 60.0)
    await page.tab.click("[data-tab=drawing]")
    await page.draw("no_fly", no_fly)
    await page.press("#drawing", "Give to the planner")
    await page.agree()
    await page.draw("search", area)
    page.say("an area is drawn, and what is kept clear of in it")
    await page.press("#drawing", "Search it")
    await page.agree()
    page.say("the search was agreed to")
    await page.tab.click("[data-tab=goals]")


async def flown(page: Page) -> None:
    """Wait until the goal under way has ended."""
    await page.until("document.querySelector('#goals progress') === null", 240.0)
    page.say("the search is flown, and all are back")
