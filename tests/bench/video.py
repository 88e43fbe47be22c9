"""What video costs and how late it is: ``python tests/bench/video.py``.

A router, 'zmav video run', 'zmav http' and a Chromium, each in a process of its own, on loopback. The delay is read
from the clock in the picture, as the browser has it to show; the costs are user and system time, of one core.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from agents.camera.streams import ClockSource, Encoding
from tests.bench.camera_link import routers
from tests.cli.conftest import Process
from tests.ground.http.browser import Tab, browser

SECONDS = 15.0
SIZE, RATE = (1280, 720), 30
BITS = 2e6
VIDEO = "import sys; from zmav import cli; from agents.camera.video_cli import video as v; cli.zmav = v; cli.main()"
HTTP = "import sys; from zmav import cli; from ground.http.cli import command as c; cli.zmav = c; cli.main()"
WATCH = """(async () => {
    const { playVideo } = await import("./static/video.js");
    const video = document.createElement("video");
    video.muted = true;
    document.body.prepend(video);
    const canvas = new OffscreenCanvas(512, 16);
    const to = canvas.getContext("2d", { willReadFrequently: true });
    const seen = { delays: [], video };
    const look = () => {
        video.requestVideoFrameCallback(look);
        to.drawImage(video, 0, 0);
        const row = to.getImageData(0, 8, 512, 1).data;
        let ms = 0;
        for (let i = 0; i < 32; i++) ms = ms * 2 + (row[4 * (16 * i + 8)] > 127 ? 1 : 0);
        seen.delays.push((Date.now() % 2 ** 32) - ms);
    };
    video.requestVideoFrameCallback(look);
    (window.seen ??= []).push(seen);
    playVideo("camera/quad1/down/webrtc", new AbortController().signal, video);
})()"""
FIGURES = """window.seen.map(({ delays, video }) => {
    const sorted = delays.slice(delays.length / 3).sort((a, b) => a - b);
    const quality = video.getVideoPlaybackQuality();
    return [delays.length, sorted[sorted.length >> 1], sorted[Math.floor(sorted.length * 0.95)],
        quality.totalVideoFrames, quality.droppedVideoFrames];
})"""


def film(path: Path, seconds: float = 4.0, bits: float = BITS) -> None:
    """A file of 720p30, as a camera would encode it."""
    stream, closed = Encoding(ClockSource(*SIZE, 1e3), RATE, stamped=True), threading.Event()
    stream.aim(bits)
    with av.open(str(path), "w") as container:
        out = container.add_mux_stream("h264", rate=RATE, width=SIZE[0], height=SIZE[1])
        for number, unit in enumerate(stream.shots(closed)):
            packet: Any = av.Packet(unit.data)
            packet.stream, packet.pts, packet.is_keyframe = out, number * 90_000 // RATE, unit.key
            packet.dts, packet.time_base = packet.pts, Fraction(1, 90_000)
            container.mux(packet)
            if number >= seconds * RATE:
                closed.set()


def processor(process: Process) -> float:
    """s of user and system time."""
    fields = Path(f"/proc/{process.popen.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def running(code: str, *options: str) -> Iterator[Process]:
    process = Process(sys.executable, "-c", code, *options)
    try:
        yield process
    finally:
        process.popen.terminate()
        process.popen.wait(20.0)


async def watched(source: str, viewers: int) -> None:
    with contextlib.ExitStack() as held:
        (_, there), _ = routers(held)
        run = ("run", source, "--vehicle", "quad1", "--budget", "2MB/s", "--loop", "-e", there)
        camera = held.enter_context(running(VIDEO, *run))
        gateway = held.enter_context(running(HTTP, "--port", "0", "-e", there))
        port = await asyncio.to_thread(_port, gateway)
        async with browser() as tab:
            await tab.open(f"http://127.0.0.1:{port}/")
            await tab.until("document.readyState === 'complete'")
            await _measure(tab, camera, gateway, source, viewers)


def _port(gateway: Process) -> int:
    while True:
        for line in (*gateway.out, *gateway.err):
            if "http://127.0.0.1:" in line:
                return int(line.partition("http://127.0.0.1:")[2].split("/")[0].split()[0].rstrip(":,"))
        if gateway.popen.poll() is not None:
            raise SystemExit("\n".join(gateway.err))


async def _measure(tab: Tab, camera: Process, gateway: Process, source: str, viewers: int) -> None:
    for _ in range(viewers):
        await tab.run(WATCH)
    await tab.until("window.seen.every((each) => each.delays.length > 5)")
    before = processor(camera), processor(gateway)
    await asyncio.sleep(SECONDS)
    after = processor(camera), processor(gateway)
    costs = [100.0 * (now - then) / SECONDS for now, then in zip(after, before, strict=True)]
    what = "encoded there, with a clock" if source == "clock" else "passed through from a file"
    print(f"{SIZE[0]}x{SIZE[1]} at {RATE} Hz, {what}, {viewers} viewers")
    print(f"  camera {costs[0]:.1f} % of a core, gateway {costs[1]:.1f} %")
    for shown, middle, late, total, dropped in await tab.run(FIGURES):
        delay = f", delay {middle:.0f} ms median, {late:.0f} ms 95 %" if source == "clock" else ""
        print(f"  {shown} pictures shown of {total} decoded, {dropped} dropped{delay}")


async def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        film(path)
        print(f"the file: {8e-6 * path.stat().st_size / 4.0:.2f} Mbit/s")
        await watched("clock", 1)
        for viewers in (1, 2):
            await watched(str(path), viewers)


if __name__ == "__main__":
    asyncio.run(main())
