"""What each program on a vehicle's computer, and the ground's bridge, costs in flight: processor and memory.

    python tests/bench/budget.py [--seconds 20] [--only sight,control]

sight: a copter follows a rover by its camera; all frames go to a GCS over the ground's router. control: EV1 flies the
hexarotor along a lemniscate. Processor is the scheduler's, of every thread, as a share of one core: what else runs here
makes it dearer, by a half or more where caches and cores are shared. PSS shares what is mapped from files among all
that map it here; on a computer with one of each it lies between PSS and RSS.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import socket
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rich.console import Console

from deploy.demos.drive import eight
from tests.bench._follow_rig import QUAD, READY, SEEN, Demonstration, Rig, scene
from tests.bench.controllers.flight import airborne, follow
from tests.bench.controllers.processes import children, cpu_seconds
from zmav.children import Children, connect_once_up

SETTLE = 5.0
"""s after which a flight goes its usual way"""


class Cost(NamedTuple):
    """Of one process."""

    core: float
    """share of one core"""
    pss: float
    rss: float
    """MB"""


class Gcs:
    """A ground station that only reads: how many frames came."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.url, self.frames = f"127.0.0.1:{self._socket.getsockname()[1]}", 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while True:
            self._socket.recv(65535)
            self.frames += 1


def memory(pid: int) -> tuple[float, float]:
    """PSS and RSS in MB."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    found = {name: int(rest.split()[0]) / 1024 for name, _, rest in (line.partition(":") for line in lines)}
    return found["Pss"], found["Rss"]


async def costs(pids: Mapping[str, int], seconds: float) -> dict[str, Cost]:
    """Of processes by name, from now on."""
    loop = asyncio.get_running_loop()
    before, begun = {name: cpu_seconds(pid) for name, pid in pids.items()}, loop.time()
    await asyncio.sleep(seconds)
    took = loop.time() - begun
    return {name: Cost((cpu_seconds(pid) - before[name]) / took, *memory(pid)) for name, pid in pids.items()}


async def sight(seconds: float) -> dict[str, Cost]:
    gcs = Gcs()
    with Children(at_once=True) as processes:
        rig = Rig(processes, processes.folder, ["--wind", "3,light", "--noise", "typical"], False)
        async with contextlib.AsyncExitStack() as stack:
            rig.start(scene(False))
            z = await connect_once_up(stack, "demo", rig.ground, processes.check)
            shown = Demonstration(z, rig.control, Console(quiet=True))
            await shown.ready()
            rig.start_agents()
            processes.start("bridge", "gcs", "--udp", gcs.url, "-e", rig.ground)
            listening = asyncio.create_task(shown.listen())
            await shown.until(lambda: {"helipad", "follower"} <= set(shown.status), "the agents' word", READY)
            flying = asyncio.create_task(shown.follow(eight(1.0), 2.0 * (SETTLE + seconds)))
            await shown.until(lambda: shown.phase == "track", "the sight of the rover", SEEN)
            await asyncio.sleep(SETTLE)
            pids = processes.pids()
            named = {
                "zmav up, one router beside it": pids[QUAD],
                "camera, 15 pictures a second of 640x480": pids["camera"],
                "helipad detector, the same": pids["helipad"],
                "follower": pids["follower"],
                "ground: router": pids["ground"],
                "ground: GCS bridge, two vehicles, one client": pids["bridge"],
            }
            then = gcs.frames
            found = await costs(named, seconds)
            print(f"sight: {(gcs.frames - then) / seconds:.0f} frames a second came to the GCS, of two vehicles")
            for task in (flying, listening):
                task.cancel()
            await asyncio.gather(flying, listening, return_exceptions=True)
    return found


async def control(seconds: float) -> dict[str, Cost]:
    async with airborne() as run:
        await run.fly_by("ev1", "ev1")
        await follow(run, "ev1", seconds + 2.0 * SETTLE)
        await asyncio.sleep(SETTLE)
        pids = run.processes.pids()
        (controller,) = children(pids["ev1"])
        named = {
            "zmav up, PX4 under a controller at 250 Hz": pids["up"],
            "EV1: its supervisor": pids["ev1"],
            "EV1: the controller's process": controller,
        }
        return await costs(named, seconds)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seconds", type=float, default=20.0)
    options.add_argument("--only", default="sight,control")
    args = options.parse_args()
    found: dict[str, Cost] = {}
    for name, measure in (("sight", sight), ("control", control)):
        if name in args.only.split(","):
            found |= asyncio.run(measure(args.seconds))
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, Python {sys.version.split()[0]}")
    print("| | of a core | PSS | RSS |\n|---|---|---|---|")
    for name, cost in found.items():
        print(f"| {name} | {cost.core:.1%} | {cost.pss:.0f} MB | {cost.rss:.0f} MB |")


if __name__ == "__main__":
    main()
