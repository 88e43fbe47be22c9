"""Planners as processes: one is killed in mid-flight, the other goes on; and what people see of it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import os
import signal
import sys
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.agents.planner.execute.fleet import Fleet, airborne
from zmav.trust import VARIABLE
from zmav.waiting import within

PATIENCE_S = 90.0
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != VARIABLE}


@contextlib.asynccontextmanager
async def zmav(fleet: Fleet, *arguments: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """``zmav swarm ...`` beside the fleet; gone at the end."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "zmav",
        "swarm",
        *arguments,
        "-e",
        fleet.endpoint,
        env=ENVIRONMENT,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


async def run(fleet: Fleet, *arguments: str) -> tuple[int, str, str]:
    """Its exit code and what it said, on both."""
    async with zmav(fleet, *arguments) as process:
        out, err = await within(PATIENCE_S, process.communicate())
        assert process.returncode is not None
        assert b"Traceback" not in err, err.decode()
        return process.returncode, out.decode(), err.decode()


async def until(process: asyncio.subprocess.Process, *words: str) -> None:
    """Wait until its log has said all of these."""

    async def read() -> None:
        assert process.stderr is not None
        left = set(words)
        while left:
            line = (await process.stderr.readline()).decode()
            assert line, f"it ended before it said {left}"
            left -= {word for word in left if word in line}

    await within(PATIENCE_S, read())


@pytest.mark.slow
async def test_a_killed_planner_s_goal_is_ended_by_the_next() -> None:
    async with airborne([(0.0, 0.0), (0.0, 8.0)], 10.0) as fleet:
        code, _, err = await run(fleet, "list")
        assert code == 1
        assert "start one with 'zmav swarm planner'" in err
        async with contextlib.AsyncExitStack() as planners:
            first = await planners.enter_async_context(zmav(fleet, "planner", "--name", "first", "--patience", "1"))
            await until(first, "is ready", "in charge")
            standby = zmav(fleet, "planner", "--name", "second", "--standby", "--patience", "1")
            second = await planners.enter_async_context(standby)
            await until(second, "is ready")
            code, out, _ = await run(fleet, "list", "--json")
            status: dict[str, Any] = json.loads(out)
            assert (code, status["planner"], status["standby"]) == (0, "first", ["second"])
            code, _, err = await run(fleet, "goto", "nobody=0,0,10")
            assert (code, "no vehicle nobody is known" in err) == (1, True)

            goal = asyncio.create_task(run(fleet, "goto", "quad1=30,8,10", "quad2=30,0,10"))
            while fleet.places()["quad1"][0] < 8.0:
                assert not goal.done(), goal.result()
                await asyncio.sleep(0.05)
            os.kill(first.pid, signal.SIGKILL)
            closest, watched = math.inf, asyncio.create_task(until(second, "done"))
            while not watched.done():
                pairs = itertools.combinations(fleet.places().values(), 2)
                closest = min(closest, *(math.dist(a, b) for a, b in pairs))
                await asyncio.sleep(0.05)
            await watched
            assert closest > 2.0
            code, out, err = await goal
            assert (code, "done" in out, "taken over from first" in out) == (0, True, True), (out, err)
            assert math.dist(fleet.places()["quad1"], (30.0, 8.0, -10.0)) < 1.0
