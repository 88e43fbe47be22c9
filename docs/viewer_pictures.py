"""Draws the pictures of the viewer: 'python docs/viewer_pictures.py [mixed] [prototype]' (five minutes each).

'zmav view --save' looks on for a while as a demo flies. Rerun's own page then shows what it wrote, in Chromium, which
must be installed; without a graphics card that takes a minute. '--seen FILE.rrd' draws what was written before.
"""

from __future__ import annotations

import argparse
import asyncio
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # before any other package called tests

from PIL import Image

from ground.view import viewer
from ground.view.painter import blueprint
from ground.view.screen import Sink
from tests.ground.http import browser
from tests.ground.http.flown_page import said
from zmav.children import Children
from zmav.process import free_port
from zmav.wire import Vector

DOCS = Path(__file__).resolve().parent
WINDOW = (1400, 900)
WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
PATIENCE_S, LOADED_S, STILL_S = 300.0, 40.0, 10.0
"""s that such a page may take to answer, until it has drawn something, and in which nothing changes when it is ready"""
WIDER = (55.0, 677.0), (140.0, 677.0)
"""pixels: the edge of the column of times in the log of events, and where it has room for them"""


class Shot(NamedTuple):
    """What is looked on at, and what of the window is kept."""

    name: str
    begin: str
    end: str
    """words of the demo: the looking on begins with these and ends some seconds after those"""
    seconds: float
    part: tuple[int, int, int, int]
    """pixels: left, top, right, bottom"""
    tab: int = 0
    """which of the plots are in front"""
    places: Sequence[Vector] = ()
    """NED: what is looked at"""


SHOTS = {
    "mixed": Shot(
        "viewer.png",
        "Copters to 12 m",
        "rover1: goto done (",
        6.0,
        (0, 36, 1400, 870),
        places=((0.0, 0.0, 0.0), (0.0, 12.0, 0.0), (-20.0, 0.0, 0.0)),
    ),
    "prototype": Shot(
        "viewer-controllers.png", "Now EV2 flies it", "Now EV2 flies it", 45.0, (1000, 36, 1400, 870), tab=2
    ),
}


async def look_on(demo: str, written: Path) -> None:
    shot, router = SHOTS[demo], f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as left, Children(at_once=True, by_signals=True) as processes:
        processes.start("demo", "demo", demo, "--endpoint", router, "--out", left)
        await said(processes, "demo", shot.begin, 600.0)
        processes.start("view", "view", "--save", str(written), "-e", router)
        await said(processes, "demo", shot.end, 600.0)
        await asyncio.sleep(shot.seconds)
        await asyncio.sleep((5.5 - time.time()) % 10.0)  # so that no time of an axis stands at its edge, cut off
        processes.check()
        processes.end("view")


async def draw(demo: str, written: Path) -> None:
    shot, source, data, port, path = SHOTS[demo], free_port(), free_port(), free_port(), DOCS / SHOTS[demo].name
    sink = Sink("web", url=viewer.proxy(data), port=data, web_port=port)
    packed = written.with_suffix(".packed.rrd")  # few large pieces: a page without a graphics card takes some a second
    subprocess.run([*viewer.program(), "rrd", "optimize", str(written), "-o", str(packed)], check=True)
    served = ["--bind", viewer.HOST, "--serve-web", "--web-viewer-port", str(source), "--port", str(data)]
    viewer.serve_page(sink, source)
    server = subprocess.Popen([*viewer.program(), str(packed), *served], stdin=subprocess.DEVNULL)
    try:
        async with browser.browser(*WEBGL) as tab:
            await tab.open(viewer.page(sink))
            await tab.size(*WINDOW)
            await asyncio.sleep(LOADED_S)
            await asyncio.to_thread(blueprint(shot.places, shot.tab).connect_grpc, "zmav", url=sink.url)
            await asyncio.sleep(STILL_S)
            await tab.drag(*WIDER)
            await still(tab, path, dark=demo == "mixed")
    finally:
        server.terminate()
        server.wait()
    with Image.open(path) as drawn:
        colours = drawn.convert("RGB").crop(shot.part).quantize(256, dither=Image.Dither.NONE)
    colours.save(path, optimize=True)
    print(f"wrote docs/{path.name}, {path.stat().st_size / 1000:.0f} kB")


async def still(tab: browser.Tab, path: Path, *, dark: bool) -> None:
    """The picture, once no more of the recording comes."""
    before = b""
    while True:
        await tab.picture(path, *WINDOW, dark=dark)
        if (now := path.read_bytes()) == before:
            return
        before = now
        await asyncio.sleep(STILL_S)


async def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("demo", nargs="*", choices=(*SHOTS, []), default=[])
    options.add_argument("--seen", type=Path, help="what 'zmav view --save' wrote: draw it, fly nothing")
    chosen = options.parse_args()
    if chosen.seen is not None and len(chosen.demo) != 1:
        options.error("--seen goes with one demo")
    browser.PATIENCE_S = PATIENCE_S
    for demo in chosen.demo or SHOTS:
        with tempfile.TemporaryDirectory(prefix="zmav-pictures-") as scratch:
            written = chosen.seen or Path(scratch) / "flight.rrd"
            if chosen.seen is None:
                await look_on(demo, written)
            await draw(demo, written)


if __name__ == "__main__":
    asyncio.run(main())
