"""The mixed demo fleet for half an hour, with a random fault every 20 s: copters, a rover and a plane, two autopilots.

    python tests/bench/soak.py [--minutes 30] [--every 20] [--seed 0]

Faults: what 'zmav sim fault' has (links cut and lossy, sensors, frozen and rebooted autopilots, the battery, the
radio), cut links between routers, the planner killed and started again. Meanwhile orders go out all the time: arm, take
off, go, hold, come home, parameters, leases with setpoints, goals of the planner. Ends with 1 where a process died that
should live, a command was neither answered nor refused within its time, or memory grew.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import random
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import msgspec

import zmav
from agents.demo.stage import DemoFleet
from agents.demo.story import Demo, Step, find
from zmav.children import Children, connect_once_up
from zmav.errors import ZmavError
from zmav.process import free_port
from zmav.sim import Remote

ANSWERED_WITHIN = 240.0
"""s: what a take-off may take, with its retries over a cut link, before it is said to hang"""
SETTLED = 0.3
"""share of the time after which memory is taken to be what it will be"""
GROWTH = 0.10
"""of a process's resident memory from then to the end, at most"""
FAULTS: dict[str, dict[str, float]] = {
    "link-cut": {},
    "link-loss": {"percent": 30.0},
    "gps-loss": {},
    "gps-glitch": {"north": 20.0},
    "compass": {},
    "baro": {"metres": 3.0},
    "imu": {"vibration": 20.0},
    "rc-loss": {},
    "frozen": {},
    "reboot": {},
    "battery": {"left_percent": 40.0},
}
FOR = (5.0, 18.0)
"""s that a fault lasts"""


class Soak:
    def __init__(self, z: zmav.Client, stage: DemoFleet, processes: Children, names: list[str], seed: int) -> None:
        self.z, self.stage, self.processes, self.names = z, stage, processes, names
        self.rng = random.Random(seed)
        self.told: dict[str, Counter[str]] = {}
        self.faults: Counter[str] = Counter()
        self.memory: dict[str, list[tuple[float, float]]] = {}
        self.hung: list[str] = []
        self.died: list[str] = []
        self.planner = 0

    # ---- faults

    async def trouble(self, every: float) -> None:
        while True:
            kind = self.rng.choice([*FAULTS, "routers cut", "routers cut", "planner killed"])
            name, lasts = self.rng.choice(self.names), self.rng.uniform(*FOR)
            self.faults[kind] += 1
            if kind == "routers cut":
                asyncio.get_running_loop().call_later(lasts, self.stage.cut, ("ground", name), True)
                self.stage.cut(("ground", name), False)
            elif kind == "planner killed":
                self.processes.kill(f"planner {self.planner}")
                self.start_planner()
            else:
                try:
                    await asyncio.to_thread(self._fault, name, kind, lasts)
                except ZmavError as e:  # not every vehicle can have every fault
                    self.faults[f"{kind} (refused: {e.code})"] += 1
            await asyncio.sleep(every)

    def _fault(self, name: str, kind: str, lasts: float) -> None:
        with Remote(self.stage.control) as sim:
            sim.fault(name, kind, for_s=None if kind == "reboot" else lasts, **FAULTS[kind])

    def start_planner(self) -> None:
        self.planner += 1
        self.processes.start(
            f"planner {self.planner}", "swarm", "planner", "--margin", "1", environment=self.stage.environment("ground")
        )

    # ---- orders

    async def orders(self) -> None:
        while True:
            vehicle = self.z.vehicle(self.rng.choice(self.names))
            name, do = self.rng.choice(list(self._orders(vehicle).items()))
            await self.ask(name, do)
            await asyncio.sleep(self.rng.uniform(0.1, 1.0))

    def _orders(self, v: zmav.Vehicle) -> dict[str, Callable[[], Awaitable[object]]]:
        height = 50.0 if v.name.startswith("plane") else 10.0
        place = (self.rng.uniform(-40.0, 40.0), self.rng.uniform(-40.0, 40.0), 0.0 if "rover" in v.name else -height)
        return {
            "arm": lambda: v.arm(ready_timeout=20.0),
            "takeoff": lambda: v.takeoff(height),
            "goto": lambda: v.goto(pos=place),
            "hold": v.hold,
            "rtl": v.rtl,
            "ping": v.ping,
            "param list": v.params.list,
            "param get": lambda: v.params.get("MAV_SYS_ID" if v.name == "quad2" else "RTL_ALT"),
            "lease": lambda: self._stream(v),
            "planner goto": lambda: self._goal(v.name, place),
        }

    async def _stream(self, v: zmav.Vehicle) -> None:
        async with v.lease("soak") as lease:
            for _ in range(30):
                lease.setpoint(vel=(1.0, 0.0, 0.0))
                await asyncio.sleep(0.1)

    async def _goal(self, name: str, place: tuple[float, float, float]) -> None:
        """As a person would give it: its program's exit code is the answer."""
        where = f"{name}={place[0]:.0f},{place[1]:.0f},{-place[2]:.0f}"
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "zmav",
            "swarm",
            "goto",
            where,
            "--no-wait",
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={"PATH": "/usr/bin:/bin", **self.stage.environment("ground")},
            cwd=Path(__file__).resolve().parents[2],
        )
        out, _ = await process.communicate()
        if process.returncode != 0:
            lines = out.decode().strip().splitlines() or ["without a word"]
            if "Traceback" in out.decode():
                self.died.append(f"zmav swarm goto: {lines[-1]}")
            raise ZmavError(lines[-1])

    async def ask(self, name: str, do: Callable[[], Awaitable[object]]) -> None:
        counts = self.told.setdefault(name, Counter())
        try:
            await asyncio.wait_for(asyncio.ensure_future(_awaited(do)), ANSWERED_WITHIN)
            counts["done"] += 1
        except ZmavError as e:
            counts[e.code] += 1
        except asyncio.TimeoutError:
            counts["HUNG"] += 1
            self.hung.append(name)

    # ---- what is watched

    async def watch(self) -> None:
        """Who died, and everybody's memory, every 5 s."""
        begun = time.monotonic()
        while True:
            try:
                self.processes.check()
            except ZmavError as e:
                if str(e) not in self.died:
                    self.died.append(str(e))
            for name, pid in self.processes.pids().items():
                with contextlib.suppress(OSError):
                    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
                    self.memory.setdefault(name, []).append((time.monotonic() - begun, pages * 4096 / 1e6))
            await asyncio.sleep(5.0)

    def grown(self, seconds: float) -> dict[str, tuple[float, float]]:
        """By process, MB in the median of the fifth after it has settled, and of the last fifth."""
        found = {}
        for name, rows in self.memory.items():
            early = [mb for t, mb in rows if SETTLED * seconds <= t < (SETTLED + 0.2) * seconds]
            late = [mb for t, mb in rows if t >= 0.8 * seconds]
            if early and late:
                found[name] = (statistics.median(early), statistics.median(late))
        return found


async def _awaited(do: Callable[[], Awaitable[object]]) -> object:
    return await do()


def everything_cuttable(demo: Demo) -> Demo:
    """With a step that names every link, so that each is laid through a relay."""
    return msgspec.structs.replace(demo, story=msgspec.structs.replace(demo.story, steps=[Step(cut=demo.links())]))


async def soak(args: argparse.Namespace, processes: Children, stage: DemoFleet, demo: Demo) -> bool:
    seconds = 60.0 * args.minutes
    async with contextlib.AsyncExitStack() as stack:
        await stage.start()
        z = await connect_once_up(stack, demo.fleet.fleet, stage.ground, processes.check)
        await z.wait_for(*demo.vehicles, timeout=90.0)
        run = Soak(z, stage, processes, demo.vehicles, args.seed)
        run.start_planner()
        tasks = [asyncio.create_task(run.trouble(args.every)), asyncio.create_task(run.watch())]
        tasks += [asyncio.create_task(run.orders()) for _ in range(3)]
        done, _ = await asyncio.wait(tasks, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            task.result()  # none of them ends by itself
        for name in demo.vehicles:
            stage.cut(("ground", name), True)
        await asyncio.to_thread(_clear, stage)
        await asyncio.sleep(20.0)
        answer = {name: await _answers(z.vehicle(name)) for name in demo.vehicles}
    return report(run, seconds, answer)


def _clear(stage: DemoFleet) -> None:
    with Remote(stage.control) as sim:
        sim.clear()


async def _answers(vehicle: zmav.Vehicle) -> str:
    try:
        return f"answers in {1e3 * await vehicle.ping():.1f} ms"
    except ZmavError as e:
        return f"DOES NOT ANSWER: {e.message}"


def report(run: Soak, seconds: float, answer: dict[str, str]) -> bool:
    print(f"{seconds / 60.0:g} min, {sum(n for k, n in run.faults.items() if '(' not in k)} faults:")
    print("  " + ", ".join(f"{n} {kind}" for kind, n in sorted(run.faults.items())))
    total = sum(sum(counts.values()) for counts in run.told.values())
    print(f"{total} commands, each answered or refused but {len(run.hung)}:")
    for name, counts in sorted(run.told.items()):
        print(f"  {name:<14}" + ", ".join(f"{n} {what}" for what, n in counts.most_common()))
    grown = run.grown(seconds)
    print("resident memory, MB, early and late:")
    print("  " + ", ".join(f"{name} {a:.0f} {b:.0f}" for name, (a, b) in grown.items()))
    fat = [name for name, (a, b) in grown.items() if b > (1.0 + GROWTH) * a]
    for name in fat:
        print(f"GREW: {name}")
    for text in run.died:
        print(f"DIED: {text}")
    print("afterwards: " + "; ".join(f"{name} {text}" for name, text in answer.items()))
    return not (run.hung or run.died or fat or any("NOT" in text for text in answer.values()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    demo = everything_cuttable(find("mixed"))
    ground = f"tcp/127.0.0.1:{free_port()}"
    with (
        tempfile.TemporaryDirectory(prefix="zmav-soak-") as folder,
        Children(at_once=True, by_signals=True) as processes,
        DemoFleet(demo, processes, Path(folder), ground, ()) as stage,
    ):
        return 0 if asyncio.run(soak(args, processes, stage, demo)) else 1


if __name__ == "__main__":
    sys.exit(main())
