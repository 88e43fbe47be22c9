"""Draws the pictures of the operator's page: 'python docs/page_pictures.py [search] [fifty]' (some minutes).

A person's pointer and keys in Chromium, which must be installed. 'search' flies 'zmav demo --stay' from the page, and
says how long each step took since the demo was started; it wants a core for itself. 'fifty' are the vehicles of
tests/bench/page.py, which say all that such do and do not fly: fifty companions would take all of a small machine.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # before any other package called tests

from PIL import Image

from tests.bench.page import served
from tests.ground.http.browser import browser
from tests.ground.http.flown_page import WIDE, Page, flown, flown_from_the_page, search

DOCS = Path(__file__).resolve().parent
MOST_BYTES = 250_000
PHONE = (400, 860)
TRACKS_S = 20.0
"""s for which the fifty are followed"""


async def picture(page: Page, name: str, size: tuple[int, int], *, dark: bool = False) -> None:
    path = DOCS / name
    await page.tab.picture(path, *size, dark=dark)
    with Image.open(path) as drawn:
        colours = drawn.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    colours.save(path, optimize=True)
    if path.stat().st_size > MOST_BYTES:
        raise RuntimeError(f"{name} has {path.stat().st_size} bytes; at most {MOST_BYTES} belong into the documents")
    page.say(f"wrote docs/{name}")


async def a_search() -> None:
    async with flown_from_the_page("line") as page:
        tab = page.tab
        await search(page)
        await page.until("document.querySelector('#goals progress')?.value > 0.41", 120.0)
        await picture(page, "page-search.png", WIDE)
        await tab.size(*PHONE)
        await tab.click("#fit")
        await picture(page, "page-phone.png", PHONE)
        await tab.size(*WIDE)
        await flown(page)


async def fifty() -> None:
    with served(50) as port:
        async with browser() as tab:
            page = Page(tab, time.monotonic())
            await page.open(port)
            await page.until("document.querySelectorAll('#rows tr').length === 50")
            await tab.click("#fit")
            await asyncio.sleep(TRACKS_S)
            await picture(page, "page-fifty.png", WIDE, dark=True)


async def main(names: list[str]) -> None:
    known = {"search": a_search, "fifty": fifty}
    for name in names or known:
        await known[name]()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
