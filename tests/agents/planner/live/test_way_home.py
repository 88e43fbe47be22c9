"""A fleet with ``return = "together"`` among simulated copters: what is stored is flown when the planner is gone."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator

import pytest

from tests.agents.planner.execute.fleet import NEAR, Fleet
from tests.agents.planner.live.led import Field, led
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
async def planned() -> AsyncIterator[Field]:
    async with led(STARTS, 10.0, failsafe=SOON, body=NEAR) as field:
        known, names = field.agent.context.fleet, field.fleet.names

        def told() -> bool:
            """The planner has asked them what they do, and where they took off."""
            seen = [known.seen(name) for name in names]
            homes = all(each is not None and each.view.home_ned is not None for each in seen)
            return homes and all(known.bodies.returns_after(name) is not None for name in names)

        await until(told, "it knows them", PATIENCE_S)
        yield field


def stored(field: Field) -> bool:
    """All say that they have a way home."""
    states = [field.me.vehicle(name).last_state for name in field.fleet.names]
    return all(state is not None and state.segment is not None and state.segment.home is not None for state in states)


async def down(fleet: Fleet) -> dict[str, float]:
    """Once all are on the ground: m over it from where each took off."""
    await until(lambda: all(-down < 0.5 for _, _, down in fleet.places().values()), "all on the ground", PATIENCE_S)
    homes = dict(zip(fleet.names, STARTS, strict=True))
    return {name: math.dist(place[:2], homes[name]) for name, place in fleet.places().items()}


async def test_the_planner_dies_and_all_come_home_apart() -> None:
    async with planned() as field:
        await field.submit(swarm.GoTo(vehicles=field.fleet.names, to=ACROSS))
        await until(lambda: stored(field), "ways home stored", PATIENCE_S)
        async with field.fleet.watch() as watch:
            await asyncio.sleep(2.5)
            field.agent.context.z.session.close()  # nothing is sent any more, and nothing is given back
            away = await down(field.fleet)
        assert watch.moved() > 5.0
        assert watch.least(1.5) > 2.0, "nobody was nearer to another than their radii"
        assert max(away.values()) < 1.5, away


async def test_a_return_goes_by_the_ways_that_are_ready() -> None:
    async with planned() as field:
        context, names = field.agent.context, field.fleet.names
        goal = await field.submit(swarm.GoTo(vehicles=names, to=ACROSS))
        await until(lambda: stored(field), "ways home stored", PATIENCE_S)
        async with field.fleet.watch() as watch:
            await until(lambda: not context.runs, f"{goal} is over", PATIENCE_S)
            await field.submit(swarm.Return(vehicles=names))
            words = "by the way home that was ready"
            await until(lambda: any(words in entry.text for entry in context.ledger.goals), words, PATIENCE_S)
            away = await down(field.fleet)
        assert watch.least(1.5) > 2.0
        assert max(away.values()) < 1.5, away
