"""The operator's page with fifty vehicles that say their state five times a second, in Chromium without graphics.

    python tests/bench/page.py [--minutes 10] [--vehicles 50] [--json]

First paint on loopback, frames a second, the main thread's share of a core, the JavaScript heap (after a collection) in
the first, the third (from then on the tracks of two minutes are full) and the last minute, and bytes a second on the
page's WebSocket with whole states and with what changed.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from websockets.asyncio.client import connect

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._load import end
from tests.bench.http_gateway import wait_for
from tests.bench.scale.footprint import ready_copter
from tests.ground.http.browser import Tab, browser
from zmav import keys, wire
from zmav.process import free_port
from zmav.session import SessionSettings, open_session

HZ = 5.0
EVERY_S = 10.0
"""s between two looks at the page"""
COUNTED_S = 10.0
THIRD = slice(round(120.0 / EVERY_S), round(180.0 / EVERY_S) + 1)
WHOLE = {"subscribe": "*", "hz": HZ}
CHANGES = {**WHOLE, "changes": True}


def publish(endpoint: str, count: int) -> None:
    """Be the fleet, and the router that the gateway links to."""
    session = open_session(SessionSettings(mode="router", listen=[endpoint], cfg=("scouting/delay:0",)))
    sent = 0
    begun = time.monotonic()
    while True:
        for number in range(count):
            state = state_of(number, time.time())
            session.put(keys.STATE.key("demo", state.name), wire.encode(state))
            sent += 1
            time.sleep(max(0.0, begun + sent / (count * HZ) - time.monotonic()))


def state_of(number: int, now: float) -> wire.VehicleState:
    """All that a copter in flight says: on a circle of its own, shaken a little."""
    turn = 0.1 * now + number
    shake = 0.02 * math.sin(7.0 * now + number)
    north, east = 40.0 * (number // 10) + 15.0 * math.cos(turn), 40.0 * (number % 10) + 15.0 * math.sin(turn)
    height = 20.0 + number + shake
    ages = dict.fromkeys(("position", "local", "attitude", "battery", "gps", "status"), 0.05 + 0.1 * (now * 3.0 % 1.0))
    return msgspec.structs.replace(
        ready_copter("demo", f"quad{number + 1}", "d41d8cd98f00b204", number),
        t=now,
        armed=True,
        status="ACTIVE",
        landed=False,
        position=wire.GlobalPosition(
            lat_deg=-35.3 + north / 110940.0, lon_deg=149.1 + east / 91000.0, alt_amsl=584.0 + height, alt_rel=height
        ),
        local=(north, east, -height),
        velocity=(-1.5 * math.sin(turn) + shake, 1.5 * math.cos(turn), shake),
        attitude=wire.Attitude(
            roll=0.05 + shake, pitch=-0.03 + shake, yaw=math.remainder(turn + math.pi / 2, math.tau)
        ),
        battery=wire.Battery(voltage=15.8 - 0.001 * (now % 600.0), current=9.0 + shake, remaining=0.8),
        gps=wire.Gps(fix="3D_FIX", satellites=14, hdop=0.8),
        clock=wire.ClockInfo(boot_t=now - 1234.5 + 1e-4 * shake, error_s=0.0004, gps_offset_s=0.001),
        ages=ages,
        setpoints={"flown": int(10.0 * now) % 100000},
        lease=wire.LeaseInfo(holder="planner", expires=now + 2.5, number=1),
        mover="segment",
    )


@contextlib.contextmanager
def served(vehicles: int) -> Iterator[int]:
    """A gateway's port, with its fleet."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    fleet = [sys.executable, __file__, "--publish", endpoint, "--vehicles", str(vehicles)]
    gateway = [sys.executable, "-m", "zmav", "http", "--port", str(port), "-e", endpoint]
    with contextlib.ExitStack() as stack:
        for command in (fleet, gateway):
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            stack.callback(end, process)
            time.sleep(1.5)
        wait_for(port)
        yield port


async def counted(port: int, ask: dict[str, Any]) -> float:
    """Bytes a second to a client with that subscription, once it has the first states."""
    async with connect(f"ws://127.0.0.1:{port}/ws", max_size=None) as socket:
        await socket.send(json.dumps(ask))
        begun = time.monotonic()
        while time.monotonic() - begun < 2.0:
            await socket.recv()
        size, begun = 0, time.monotonic()
        while time.monotonic() - begun < COUNTED_S:
            size += len(await socket.recv())
        return size / (time.monotonic() - begun)


class Look:
    """What the page is at one time."""

    def __init__(self, metrics: dict[str, float], frames: int) -> None:
        self.t, self.heap, self.busy, self.frames = (
            metrics["Timestamp"],
            metrics["JSHeapUsedSize"],
            metrics["TaskDuration"],
            frames,
        )


async def look(tab: Tab) -> Look:
    await tab.call("HeapProfiler.collectGarbage")
    answer = await tab.call("Performance.getMetrics")
    return Look({each["name"]: each["value"] for each in answer["metrics"]}, await tab.run("window.frames_drawn"))


async def run(minutes: float, vehicles: int) -> dict[str, Any]:
    with served(vehicles) as port:
        async with browser() as tab:
            await tab.open(f"http://127.0.0.1:{port}/")
            await tab.until(f"document.querySelectorAll('#rows tr').length === {vehicles}")
            paint = await tab.run("performance.getEntriesByName('first-contentful-paint')[0].startTime")
            await tab.run("""(() => {
                window.frames_drawn = 0;
                const count = () => { window.frames_drawn++; requestAnimationFrame(count); };
                count();
            })()""")
            await tab.call("Performance.enable")
            whole, changes = await asyncio.gather(counted(port, WHOLE), counted(port, CHANGES))
            looks = [await look(tab)]
            while looks[-1].t - looks[0].t < 60.0 * minutes:
                await asyncio.sleep(EVERY_S)
                looks.append(await look(tab))
            said = tab.said
    took = looks[-1].t - looks[0].t
    minute = max(2, round(min(60.0, took / 2) / EVERY_S) + 1)
    return {
        "vehicles": vehicles,
        "minutes": took / 60.0,
        "first_paint_ms": paint,
        "frames_per_s": (looks[-1].frames - looks[0].frames) / took,
        "main_thread": (looks[-1].busy - looks[0].busy) / took,
        "heap_first_mb": statistics.median(each.heap for each in looks[:minute]) / 1e6,
        "heap_third_mb": statistics.median(each.heap for each in looks[THIRD] or looks[-1:]) / 1e6,
        "heap_last_mb": statistics.median(each.heap for each in looks[-minute:]) / 1e6,
        "whole_kb_per_s": whole / 1e3,
        "changes_kb_per_s": changes / 1e3,
        "said": said,
    }


def show(found: dict[str, Any]) -> None:
    print(f"{found['vehicles']} vehicles at {HZ:g} Hz for {found['minutes']:.1f} min")
    print(f"first paint           {found['first_paint_ms']:7.0f} ms")
    print(f"frames                {found['frames_per_s']:7.1f} a second")
    print(f"main thread           {100 * found['main_thread']:7.1f} % of a core")
    print(f"heap, first minute    {found['heap_first_mb']:7.2f} MB")
    print(f"heap, third minute    {found['heap_third_mb']:7.2f} MB")
    print(f"heap, last minute     {found['heap_last_mb']:7.2f} MB")
    print(f"whole states          {found['whole_kb_per_s']:7.1f} kB/s")
    print(f"what changed          {found['changes_kb_per_s']:7.1f} kB/s")
    for each in found["said"]:
        print(f"the page said: {each}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--publish", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.publish:
        publish(args.publish, args.vehicles)
    found = asyncio.run(run(args.minutes, args.vehicles))
    print(json.dumps(found)) if args.json else show(found)


if __name__ == "__main__":
    main()
