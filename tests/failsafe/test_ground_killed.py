"""All that runs on the ground is killed (-9) at once, with a planner's goal in flight: router, planner, recorder,
bridge and gateway. The vehicles keep apart, follow their ladder, and all programs can be started again.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

import zmav
from agents.planner.cli.asking import find
from ground.record.mcapfile import read_forth
from tests.agents.planner.execute.fleet import Fleet, airborne
from tests.cli.conftest import Process, StartProcess, start
from zmav import keys, wire
from zmav.config import Failsafe
from zmav.errors import ZmavError
from zmav.process import free_port
from zmav.waiting import together, within
from zmav.wire import swarm

__all__ = ["start"]  # the fixture

PATIENCE_S = 90.0
NAMES = ["quad1", "quad2", "quad3"]
EAST, HEIGHT, FAR = (0.0, 8.0, 16.0), 10.0, 50.0
APART_M = 2.0


class Ground:
    """The programs of one ground station, always at the same places."""

    def __init__(self, fleet: Fleet, start: StartProcess, out: Path) -> None:
        self._fleet, self._start, self.out = fleet, start, out
        self.endpoint, self.tcp, self.http = f"tcp/127.0.0.1:{free_port()}", free_port(), free_port()
        self.running: list[Process] = []

    def open(self) -> None:
        """Start all five; each has said that it works."""
        router = self._start("router", "--name", "ground", "-l", self.endpoint, "-e", self._fleet.endpoint)
        router.expect("router ")
        programs = {
            "recording ": ("record", "--out", str(self.out), "--keep-free", "0"),
            "quad3 is there": ("gcs", "--tcp", str(self.tcp)),
            "fleet demo at ": ("http", "--port", str(self.http)),
            "is in charge": ("swarm", "planner", "--name", "ground", "--patience", "1"),
        }
        started = {words: self._start(*arguments, "-e", self.endpoint) for words, arguments in programs.items()}
        for words, process in started.items():
            process.expect(words)
        self.running = [router, *started.values()]
        self.running[-1].expect("is ready")

    def kill(self) -> None:
        for process in self.running:
            process.popen.kill()
        for process in self.running:
            process.wait()
            assert "Traceback" not in process.stderr, process.stderr

    def vehicles(self) -> set[str]:
        """As the gateway lists them."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}/vehicles", timeout=5.0) as reply:
            listed = reply.read().decode()
        return {name for name in NAMES if name in listed}

    def frames(self) -> bytes:
        """What the bridge sends to a station."""
        with socket.create_connection(("127.0.0.1", self.tcp), timeout=10.0) as station:
            return station.recv(4096)

    def recorded(self) -> Iterator[dict[str, set[float]]]:
        """Of each recording, by age: when the states in it were said, by vehicle."""
        for path in sorted(self.out.glob("*/record.*.mcap")):
            found: dict[str, set[float]] = {name: set() for name in NAMES}
            for each in read_forth(path):
                for name in NAMES:
                    if each.key == keys.STATE.key("demo", name):
                        found[name].add(json.loads(each.data)["t"])
            yield found


async def flown(z: zmav.Client, goal: swarm.Goal) -> str:
    """Have the planner in charge do that; how it ended."""
    planner = await find(z)
    number = (await planner.order("submit", swarm.Submit(goal=goal)))["goal"]
    while True:
        book = (await planner.order("status", wire.Order()))["book"]
        entry = next(entry for entry in book["goals"] if entry["id"] == number)
        if entry["state"] in ("done", "failed", "cancelled"):
            return f"{entry['state']} {entry['text']}"
        await asyncio.sleep(0.1)


@pytest.mark.slow
@pytest.mark.timeout(300)
async def test_the_whole_ground_is_killed_in_flight_and_started_again(start: StartProcess, tmp_path: Path) -> None:
    ladder = Failsafe(land_after=5.0)
    async with airborne([(0.0, east) for east in EAST], HEIGHT, failsafe=ladder) as fleet:
        ground = Ground(fleet, start, tmp_path / "recordings")
        await asyncio.to_thread(ground.open)
        assert await asyncio.to_thread(ground.frames)
        far = swarm.GoTo(vehicles=NAMES, to=[(FAR, east, -HEIGHT) for east in reversed(EAST)])
        goal = asyncio.create_task(flown(fleet.z, far))
        async with fleet.watch() as watch:
            await watch.until(lambda: goal.done() or bool(watch.rows and watch.moved() > 15.0), "they are on their way")
            assert not goal.done(), goal.result()
            killed = max(vehicle.state.t for vehicle in fleet.z.fleet())
            await asyncio.to_thread(ground.kill)
            goal.cancel()
            with contextlib.suppress(asyncio.CancelledError, ZmavError):
                await goal
            await watch.until(lambda: watch.still(2.0), "they come to rest where what they were committed to ends")
            rest = fleet.places()
            assert all(15.0 < place[0] < FAR + 1.0 for place in rest.values()), rest
            vehicles = [fleet.z.vehicle(name) for name in NAMES]
            assert {vehicle.state.mode for vehicle in vehicles} == {"GUIDED"}
            await together(*(vehicle.wait_until(lambda s: s.mode == "RTL", PATIENCE_S) for vehicle in vehicles))
            assert watch.least(1.5) > APART_M
        fleet.world.set_speed(6.0)
        await together(*(vehicle.wait_until(lambda s: not s.armed, PATIENCE_S) for vehicle in vehicles))
        fleet.world.set_speed(1.0)

        await asyncio.to_thread(ground.open)

        async def listed() -> None:
            while await asyncio.to_thread(ground.vehicles) != set(NAMES):
                await asyncio.sleep(0.1)

        await within(PATIENCE_S, listed())
        assert await asyncio.to_thread(ground.frames)
        fleet.world.set_speed(4.0)
        end = await within(PATIENCE_S, flown(fleet.z, swarm.TakeOff(vehicles=NAMES, height=HEIGHT)))
        assert end.startswith("done"), end
        await asyncio.to_thread(ground.kill)

        first, second = await asyncio.to_thread(lambda: list(ground.recorded()))
        for name in NAMES:
            assert max(first[name]) > killed - 2.0, "complete but for the last second"
            assert min(second[name]) > max(first[name])
