"""Simulated copters in the air, a planner that is in charge of them, and a client."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

import zmav
from agents.planner.cli.asking import Planner, books, find
from agents.planner.live import resting
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.agents.planner.execute.fleet import Fleet, starting
from tests.waiting import until
from zmav import wire
from zmav.waiting import together, within
from zmav.wire import swarm

PATIENCE_S = 60.0
USUAL = PlannerSettings(name="ground", patience=1.0)


class Field:
    """Copters in the air, a planner that is ready, and a client as people have it."""

    def __init__(self, fleet: Fleet, agent: Agent, me: zmav.Client) -> None:
        self.fleet, self.agent, self.me = fleet, agent, me
        self.closest = math.inf

    async def planner(self) -> Planner:
        return await find(self.me)

    async def submit(self, goal: swarm.Goal, when: Any = "now") -> str:
        return str((await (await self.planner()).order("submit", swarm.Submit(goal=goal, when=when)))["goal"])

    async def at_rest(self) -> None:
        """Wait until each has told the planner, in a state of after now, that it rests. A takeoff is done below its
        height: who still climbs is taken to go on climbing, and others are planned round that.
        """
        now, since, context = time.time(), time.monotonic(), self.agent.context

        def unrest() -> list[str]:
            seen = {name: context.fleet.seen(name) for name in self.fleet.names}
            late = [name for name, each in seen.items() if each is None or each.state.t < now]
            return [*late, *filter(None, (resting.unrest(context, name, since) for name in seen))]

        await until(lambda: not unrest(), unrest, PATIENCE_S)

    async def until(self, name: str, true: Callable[[swarm.GoalEntry], bool]) -> swarm.GoalEntry:
        """What the book says of a goal once ``true`` holds of it."""

        async def look() -> swarm.GoalEntry:
            last: swarm.GoalEntry | None = None
            async for book in books(self.me, PATIENCE_S):
                for entry in book.goals if book else []:
                    if entry.id == name:
                        last = entry
                        if true(entry):
                            return entry
                if last is not None and last.state in ("failed", "cancelled"):
                    raise AssertionError(f"it ended as {last}")
            raise AssertionError("no book")

        return await within(PATIENCE_S, look())

    async def watch(self) -> None:
        """Where they truly are, for ever."""
        while True:
            places = self.fleet.places().values()
            self.closest = min(self.closest, *(math.dist(a, b) for a, b in itertools.combinations(places, 2)))
            await asyncio.sleep(0.05)

    def away(self, name: str, goal: wire.Vector) -> float:
        return math.dist(self.fleet.places()[name], goal)


@contextlib.asynccontextmanager
async def led(
    starts: Sequence[tuple[float, float]],
    height: float,
    settings: PlannerSettings = USUAL,
    **how: Any,
) -> AsyncIterator[Field]:
    """As ``airborne`` has them; the solver loads while they rise."""
    async with contextlib.AsyncExitStack() as stack:
        fleet = await stack.enter_async_context(starting(starts, **how))
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        agent = await stack.enter_async_context(Agent(z, settings))
        me = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        await together(fleet.rise(height), agent.context.solver.until_ready(PATIENCE_S))
        field = Field(fleet, agent, me)
        await field.at_rest()
        await field.planner()  # it is in charge: whichever test of these a worker runs first
        yield field
