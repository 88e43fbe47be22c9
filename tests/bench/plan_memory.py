"""A planner's memory over repeated goals: ``python tests/bench/plan_memory.py [--goals 200]``.

One ``zmav swarm planner`` flies three simulated copters to and fro, goal after goal. A line now and then says what its
process and its solver's hold (resident set, MB).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import time
from pathlib import Path

import zmav
from agents.planner.cli.asking import Planner, find
from tests.agents.planner.execute.fleet import airborne
from zmav.errors import ZmavError
from zmav.wire import swarm

STARTS = ((0.0, 0.0), (0.0, 8.0), (0.0, 16.0))
HEIGHT = 10.0
ENDED = ("done", "failed", "cancelled")
LOOK = 0.1


def resident(pid: int) -> float:
    """MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def children(pid: int) -> list[int]:
    return [int(found) for found in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


async def flown(planner: Planner, north: float) -> str:
    """Have all three go there; how the goal ended."""
    to = [(north, east, -HEIGHT) for _, east in STARTS]
    goal = swarm.GoTo(vehicles=[f"quad{i + 1}" for i in range(len(STARTS))], to=to)
    name = (await planner.order("submit", swarm.Submit(goal=goal)))["goal"]
    while True:
        status = await planner.order("status", zmav.wire.Order())
        state = next((each["state"] for each in status["book"]["goals"] if each["id"] == name), "gone")
        if state in ENDED or state == "gone":
            return str(state)
        await asyncio.sleep(LOOK)


async def measure(goals: int) -> None:
    looks = {1, *(round(goals * share) for share in (0.1, 0.25, 0.5, 0.75, 1.0))}
    async with airborne(STARTS, HEIGHT) as fleet:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "zmav",
            "swarm",
            "planner",
            "--name",
            "p",
            "--patience",
            "1",
            "-e",
            fleet.endpoint,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            planner = None
            while planner is None or not (await planner.order("status", zmav.wire.Order()))["ready"]:
                with contextlib.suppress(ZmavError):
                    planner = await find(fleet.z)
                await asyncio.sleep(1.0)
            began, ends = time.monotonic(), dict[str, int]()
            for number in range(1, goals + 1):
                end = await flown(planner, 3.0 if number % 2 else 0.0)
                ends[end] = ends.get(end, 0) + 1
                if number in looks:
                    solver = " ".join(f"{resident(pid):.1f}" for pid in children(process.pid))
                    print(
                        f"goals {number:4d}: planner {resident(process.pid):.1f} MB, solver {solver} MB,"
                        f" {time.monotonic() - began:.0f} s, {ends}",
                        flush=True,
                    )
        finally:
            process.kill()
            await process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=200)
    asyncio.run(measure(parser.parse_args().goals))


if __name__ == "__main__":
    main()
