"""(d) What a flight with aggressive commands costs each process, and how many cycles have no output in time."""

from __future__ import annotations

import asyncio

import msgspec

from tests.bench.controllers.flight import airborne, follow
from tests.bench.controllers.processes import Rig, children, cpu_seconds, load

AGENT = "ev1"
SIMULATOR, UP, SUPERVISOR, CONTROLLER = "simulator", "vehicle agent and router", "supervisor", "controller"


class Cpu(msgspec.Struct):
    """Over ``seconds`` of flight."""

    percent: dict[str, float]
    """of one processor, by process"""
    cycles: int
    late: int
    """that began before the output of the one before had come"""
    seconds: float
    load: float
    """of the machine at the end"""

    @property
    def missed(self) -> float:
        """The share of late cycles."""
        return self.late / self.cycles if self.cycles else 0.0


def percent(before: dict[str, float], after: dict[str, float], seconds: float) -> dict[str, float]:
    """Of one processor, by name, from processor seconds at the beginning and at the end."""
    return {name: 100.0 * (after[name] - used) / seconds for name, used in before.items()}


async def measure(seconds: float) -> Cpu:
    """Over a flight of EV1 along the lemniscate."""
    async with airborne() as run:
        await run.fly_by(AGENT, AGENT)
        await follow(run, AGENT, seconds + 5.0)
        await asyncio.sleep(1.5)
        first, loop = await _tally(run), asyncio.get_running_loop()
        before, begun = _used(run), loop.time()
        await asyncio.sleep(seconds)
        after, lasted = _used(run), loop.time() - begun
        last = await _tally(run)
    return Cpu(percent(before, after, lasted), last[0] - first[0], last[1] - first[1], lasted, load())


async def _tally(run: Rig) -> tuple[int, int]:
    status = await run.status(AGENT, lambda status: status.state == "controller", 10.0)
    return int(status.detail["cycles"]), int(status.detail["late"])


def _used(run: Rig) -> dict[str, float]:
    """Processor seconds so far; the controller's process is the supervisor's child."""
    pids = run.processes.pids()
    return {
        SIMULATOR: cpu_seconds(pids["simulator"]),
        UP: cpu_seconds(pids["up"]),
        SUPERVISOR: cpu_seconds(pids[AGENT]),
        CONTROLLER: sum(cpu_seconds(child) for child in children(pids[AGENT])),
    }
