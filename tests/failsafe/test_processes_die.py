"""Real processes on the ground die or hang beside an agent that flies: what the vehicle makes of it.

``pytest -s`` prints how long each took, for docs/safety.md.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Process
from tests.failsafe.conftest import agent, held, moves, stops
from tests.services.conftest import Bench, StartBench
from zmav.process import free_port

AGENT = """
import asyncio, sys, zmav

class Victim(zmav.Agent):
    '''Streams a velocity; raises after so many of them.'''

    name = "victim"

    async def run(self):
        async with self.vehicle.lease("victim", ttl=60) as lease:
            for _ in range({count}):
                lease.setpoint(vel=(1.5, -0.5, 0.25))
                await asyncio.sleep(0.05)
            raise RuntimeError("planted")
"""
FOREVER = 100_000
Start = Callable[..., Process]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start ``zmav ARGUMENTS``; what still runs at the test's end is killed."""
    started: list[Process] = []

    def start(*arguments: str) -> Process:
        started.append(Process(sys.executable, "-m", "zmav", *arguments))
        return started[-1]

    yield start
    for process in started:
        process.popen.kill()
        process.wait()


async def armed(bench: StartBench) -> Bench:
    """A vehicle that is armed in GUIDED and that nobody holds."""
    b = await bench()
    alice = await agent(b, "alice")
    await b.ground.do("release", lease=alice.token)
    return b


async def flown(b: Bench, start: Start, tmp_path: Path, endpoint: str, count: int = FOREVER) -> Process:
    """A drop-in agent, run from its file, that flies the vehicle by way of that router."""
    path = tmp_path / "victim.py"
    path.write_text(AGENT.format(count=count))
    process = start("agent", "run", str(path), "--vehicle", "quad1", "-e", endpoint)
    await b.peer.until(lambda: len(moves(b)) > 3, "its stream")
    assert stops(b) == []
    return process


async def holds(b: Bench, since: float, what: str) -> None:
    """It is told to stop, its lease ends, and nothing moves it after that."""
    await held(b)
    print(f"{what}: told to stop {stops(b)[0].at - since:.2f} s after", file=sys.stderr)
    state = await b.state(lambda s: s["lease"] is None, "no lease")
    assert state["lease_end"]["holder"] == "victim"
    assert not [t for t in moves(b) if t.at > stops(b)[0].at]


def now() -> float:
    return asyncio.get_running_loop().time()


async def test_the_router_that_an_agent_flies_through_is_killed(
    bench: StartBench, start: Start, tmp_path: Path
) -> None:
    b = await armed(bench)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    ground = start("router", "--name", "ground", "-l", endpoint, "-e", b.endpoint)
    ground.expect("router ")
    await flown(b, start, tmp_path, endpoint)
    at = now()
    ground.popen.kill()
    await holds(b, at, "the ground's router killed")
    await b.event("victim, who held the lease, is gone", kind="lease")


async def test_an_agent_hangs(bench: StartBench, start: Start, tmp_path: Path) -> None:
    b = await armed(bench)
    process = await flown(b, start, tmp_path, b.endpoint)
    at = now()
    os.kill(process.popen.pid, signal.SIGSTOP)
    await holds(b, at, "a drop-in agent stopped")


async def test_an_agent_is_killed(bench: StartBench, start: Start, tmp_path: Path) -> None:
    b = await armed(bench)
    process = await flown(b, start, tmp_path, b.endpoint)
    at = now()
    process.popen.kill()
    await holds(b, at, "a drop-in agent killed")


async def test_an_agent_raises(bench: StartBench, start: Start, tmp_path: Path) -> None:
    """It gives its lease back on the way out, and ends with its own words."""
    b = await armed(bench)
    process = await flown(b, start, tmp_path, b.endpoint, count=20)
    assert await asyncio.to_thread(process.wait) != 0
    assert "planted" in process.stderr
    await held(b)
    assert (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]["reason"] == "released"


@pytest.mark.parametrize("program", ["gcs", "record", "http"])
async def test_what_only_watches_is_killed(bench: StartBench, start: Start, tmp_path: Path, program: str) -> None:
    """The agent flies on, and the vehicle's states say so."""
    b = await armed(bench)
    arguments = {
        "gcs": ["--tcp", str(free_port())],
        "record": ["--out", str(tmp_path)],
        "http": ["--port", str(free_port())],
    }[program]
    watching = start(program, *arguments, "-e", b.endpoint)
    words = {"gcs": "quad1 is there", "record": "", "http": ""}[program]
    await asyncio.to_thread(watching.expect, words)
    await flown(b, start, tmp_path, b.endpoint)
    watching.popen.kill()
    watching.wait()
    put = len(moves(b))
    await b.peer.until(lambda: len(moves(b)) > put + 20, "the stream goes on")
    assert stops(b) == []
    state = await b.state(lambda s: True, "a state")
    assert state["lease"]["holder"] == "victim"
