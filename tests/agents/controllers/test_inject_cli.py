"""``zmav agent inject``: orders, records and reports, against an agent that follows with a first-order lag."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import pytest
from click.testing import CliRunner

import zmav
from agents.controllers.cli.inject import inject, respond
from agents.controllers.inject import Inject, Injection
from agents.controllers.response import StepResponse
from agents.controllers.types import Reference
from zmav import keys, wire
from zmav.errors import BadInput, Refused, TimedOut
from zmav.verbs import Access, Verb

if TYPE_CHECKING:
    from tests.conftest import Net

LAG, PERIOD = 0.3, 0.01
STEP = Inject(kind="step", channel="z", amplitude=-1.0, seconds=3.0)


class Lagging(zmav.Agent):
    """Says its signals ten times as fast as their times tell."""

    name = "lagging"
    verbs: ClassVar = {"inject": Verb("inject", Inject, Access.MOVE, "add to the reference")}

    def __init__(self, *args: Any, **rest: Any) -> None:
        super().__init__(*args, **rest)
        self.t, self.z_now = 1000.0, -3.0
        self.injection: Injection | None = None
        self.refusal: Refused | None = None
        self.engaged, self.without, self.ends_at = True, "", math.inf

    async def run(self) -> None:
        while self.engaged and self.t < self.ends_at:
            self.t += PERIOD
            reference, added = Reference(), 0.0
            reference.pos[2] = -3.0
            if self.injection is not None:
                added = self.injection.apply(reference, self.t)
            wanted = float(reference.pos[2])
            values = {"ref.z": wanted, "is.z": self.z_now, "inject": added, "out.thrust": 0.5, "mine": 1.0}
            values.pop(self.without, None)
            key = keys.AGENT_OUT.key(self.vehicle.fleet, self.vehicle.name, agent=self.name, topic="signals")
            self.z.put(keys.AGENT_OUT, key, wire.Signals(t=self.t, values=values))
            self.z_now = wanted + (self.z_now - wanted) * math.exp(-PERIOD / LAG)
            await asyncio.sleep(PERIOD / 10.0)
        await asyncio.Event().wait()

    async def on_inject(self, args: Inject, report: Any, origin: object) -> dict[str, Any]:
        if self.refusal is not None:
            raise self.refusal
        self.injection = Injection(args, "position", self.t)
        return {}


@pytest.fixture
async def flown(net: Net) -> AsyncIterator[tuple[zmav.Client, Lagging, str]]:
    """Who asks, the agent, and where the router listens."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, zmav.open(connect=[endpoint]) as theirs:
        agent = Lagging(theirs, "hex1")
        async with agent:
            yield z, agent, endpoint


@contextlib.asynccontextmanager
async def running(agent: zmav.Agent) -> AsyncIterator[None]:
    task = asyncio.create_task(agent.run())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_step_is_ordered_recorded_and_examined(flown: tuple[zmav.Client, Lagging, str]) -> None:
    z, agent, _ = flown
    async with running(agent):
        report = await respond(z, "hex1", "lagging", STEP, after=0.5)
    assert isinstance(report.found, StepResponse)
    assert report.found.rise == pytest.approx(math.log(9.0) * LAG, rel=0.05)
    assert report.found.final == pytest.approx(-1.0, abs=1e-3)
    assert report.t[0] <= -1.0
    assert report.t[-1] >= STEP.seconds + 0.5
    assert list(report.outputs) == ["thrust"]
    assert report.title == "hex1/lagging"


async def test_the_command_prints_and_draws_it(flown: tuple[zmav.Client, Lagging, str], tmp_path: Path) -> None:
    _, agent, endpoint = flown
    file = tmp_path / "response.png"
    words = ["lagging", "step", "--channel", "z", "--amplitude", "1", "--seconds", "3", "--vehicle", "hex1"]
    async with running(agent):
        said = await asyncio.to_thread(CliRunner().invoke, inject, [*words, "-e", endpoint, "-o", str(file)])
        assert said.exception is None, said.exception
        assert "step of 1 m in z, 3 s" in said.output
        assert "rise time (10-90 %)" in said.output
        assert file.read_bytes().startswith(b"\x89PNG")
        said = await asyncio.to_thread(CliRunner().invoke, inject, [*words, "-e", endpoint, "--json"])
    found = json.loads(said.output)
    assert found["steady_error"] == pytest.approx(0.0, abs=1e-3)
    assert (found["kind"], found["channel"], found["unit"]) == ("step", "z", "m")


async def test_what_the_agent_refuses_is_said_with_its_reason(
    flown: tuple[zmav.Client, Lagging, str],
) -> None:
    z, agent, _ = flown
    async with running(agent):
        with pytest.raises(BadInput, match="a reference of level position has"):
            await respond(z, "hex1", "lagging", Inject(kind="step", channel="p", amplitude=0.1, seconds=1.0))

        agent.refusal = Refused("the autopilot flies: engage first")
        with pytest.raises(Refused, match="engage first"):
            await respond(z, "hex1", "lagging", STEP)


async def test_one_that_is_silent_is_told_to_be_engaged(
    flown: tuple[zmav.Client, Lagging, str],
) -> None:
    z, agent, _ = flown
    with pytest.raises(TimedOut, match="agent do lagging engage"):
        await respond(z, "hex1", "lagging", STEP, silent=0.3)
    agent.ends_at = agent.t + 2.0
    async with running(agent):
        with pytest.raises(TimedOut, match="before all was injected: it was released"):
            await respond(z, "hex1", "lagging", STEP, silent=0.3)


async def test_a_signal_that_is_missing_is_named(flown: tuple[zmav.Client, Lagging, str]) -> None:
    z, agent, _ = flown
    agent.without = "is.z"
    async with running(agent):
        with pytest.raises(BadInput, match=r"no signal is\.z"):
            await respond(z, "hex1", "lagging", STEP, after=0.0)
