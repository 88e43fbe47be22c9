"""A fleet with ``return = "together"`` among simulated copters: what is stored is flown when the planner is gone."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator

import pytest

import zmav
from agents.planner.cli.asking import find
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.agents.planner.execute.fleet import Fleet, airborne
from tests.waiting import until
from zmav.config import Failsafe
from zmav.wire import swarm

PATIENCE_S = 90.0
pytestmark = pytest.mark.timeout(300)  # 70 s each, of which most is the way home and the landing
STARTS = [(0.0, 0.0), (0.0, 9.0), (0.0, 18.0)]
"""as far apart as landing places are for what positions may be off; else another place is landed at"""
ACROSS = [(14.0, 18.0, -10.0), (14.0, 0.0, -10.0), (9.0, 9.0, -10.0)]
SOON = Failsafe(land_after=3.0, action="land", returns="together")


@contextlib.asynccontextmanager
async def planned(failsafe: Failsafe = SOON) -> AsyncIterator[tuple[Fleet, Agent, zmav.Client]]:
    async with contextlib.AsyncExitStack() as stack:
        fleet = await stack.enter_async_context(airborne(STARTS, 10.0, failsafe=failsafe))
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        agent = await stack.enter_async_context(Agent(z, PlannerSettings(name="ground", patience=1.0)))
        await agent.context.solver.until_ready(PATIENCE_S)
        me = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        known = agent.context.fleet

        def told() -> bool:
            """It has asked them what they do, and where they took off."""
            seen = [known.seen(name) for name in fleet.names]
            homes = all(each is not None and each.view.home_ned is not None for each in seen)
            return homes and all(known.bodies.returns_after(name) is not None for name in fleet.names)

        await until(told, "it knows them", PATIENCE_S)
        yield fleet, agent, me


async def submit(me: zmav.Client, goal: swarm.Goal) -> str:
    planner = await find(me)
    return str((await planner.order("submit", swarm.Submit(goal=goal)))["goal"])


def stored(fleet: Fleet, me: zmav.Client) -> int:
    """How many say that they have a way home."""
    states = [me.vehicle(name).last_state for name in fleet.names]
    return sum(state is not None and state.segment is not None and state.segment.home is not None for state in states)


async def down(fleet: Fleet) -> dict[str, float]:
    """Once all are on the ground: m over it from where each took off."""
    await until(lambda: all(-down < 0.5 for _, _, down in fleet.places().values()), "all on the ground", PATIENCE_S)
    homes = dict(zip(fleet.names, STARTS, strict=True))
    return {name: math.dist(place[:2], homes[name]) for name, place in fleet.places().items()}


async def test_the_planner_dies_and_all_come_home_apart() -> None:
    async with planned() as (fleet, agent, me):
        await submit(me, swarm.GoTo(vehicles=fleet.names, to=ACROSS))
        await until(lambda: stored(fleet, me) == len(fleet.names), "ways home stored", PATIENCE_S)
        async with fleet.watch() as watch:
            await asyncio.sleep(2.5)
            agent.context.z.session.close()  # nothing is sent any more, and nothing is given back
            away = await down(fleet)
        assert watch.moved() > 5.0
        assert watch.least(1.5) > 2.0, "nobody was nearer to another than their radii"
        assert max(away.values()) < 1.5, away


async def test_a_return_goes_by_the_ways_that_are_ready() -> None:
    async with planned() as (fleet, agent, me):
        goal = await submit(me, swarm.GoTo(vehicles=fleet.names, to=ACROSS))
        await until(lambda: stored(fleet, me) == len(fleet.names), "ways home stored", PATIENCE_S)
        async with fleet.watch() as watch:
            await until(lambda: not agent.context.runs, f"{goal} is over", PATIENCE_S)
            await submit(me, swarm.Return(vehicles=fleet.names))
            words = "by the way home that was ready"
            await until(lambda: any(words in entry.text for entry in agent.context.ledger.goals), words, PATIENCE_S)
            away = await down(fleet)
        assert watch.least(1.5) > 2.0
        assert max(away.values()) < 1.5, away
