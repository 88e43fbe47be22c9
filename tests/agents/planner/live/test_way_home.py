"""A fleet with ``return = "together"`` among simulated copters: what is stored is flown when the planner is gone."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.agents.planner.live.led import Field, led
from tests.waiting import until
from zmav.config import Failsafe
from zmav.wire import swarm

PATIENCE_S = 90.0
pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.timeout(300)]
STARTS = [(0.0, 0.0), (0.0, 9.0), (0.0, 18.0)]
"""as far apart as landing places are for what positions may be off; else another place is landed at"""
ACROSS = [(14.0, 18.0, -10.0), (14.0, 0.0, -10.0), (9.0, 9.0, -10.0)]
SOON = Failsafe(land_after=3.0, action="land", returns="together")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def flown() -> AsyncIterator[Field]:
    async with led(STARTS, 10.0, failsafe=SOON) as field:
        known, names = field.agent.context.fleet, field.fleet.names

        def told() -> bool:
            """It has asked them what they do, and where they took off."""
            seen = [known.seen(name) for name in names]
            homes = all(each is not None and each.view.home_ned is not None for each in seen)
            return homes and all(known.bodies.returns_after(name) is not None for name in names)

        await until(told, "it knows them", PATIENCE_S)
        yield field


@pytest_asyncio.fixture(loop_scope="module")
async def field(flown: Field) -> Field:
    """All are in the air: whom the test before has landed, again."""
    vehicles = [flown.me.vehicle(name) for name in flown.fleet.names]
    if any(-down < 5.0 for _, _, down in flown.fleet.places().values()):
        with flown.fleet.quickly():
            for vehicle in vehicles:
                await vehicle.wait_until(lambda state: state.armed is False and state.lease is None, PATIENCE_S)
            await flown.fleet.rise(10.0)
    return flown


async def crossing(field: Field) -> str:
    """A goal whose vehicles have ways home by now."""
    goal = await field.submit(swarm.GoTo(vehicles=field.fleet.names, to=ACROSS))

    def stored() -> bool:
        states = [field.me.vehicle(name).last_state for name in field.fleet.names]
        return all(state and state.segment is not None and state.segment.home is not None for state in states)

    await until(stored, "ways home stored", PATIENCE_S)
    return goal


async def down(field: Field) -> dict[str, float]:
    """Once all are on the ground: m over it from where each took off."""
    fleet = field.fleet
    await until(lambda: all(-down < 0.5 for _, _, down in fleet.places().values()), "all on the ground", PATIENCE_S)
    homes = dict(zip(fleet.names, STARTS, strict=True))
    return {name: math.dist(place[:2], homes[name]) for name, place in fleet.places().items()}


async def test_a_return_goes_by_the_ways_that_are_ready(field: Field) -> None:
    goal, context = await crossing(field), field.agent.context
    async with field.fleet.watch() as watch:
        await until(lambda: not context.runs, f"{goal} is over", PATIENCE_S)
        await field.submit(swarm.Return(vehicles=field.fleet.names))
        words = "by the way home that was ready"
        await until(lambda: any(words in entry.text for entry in context.ledger.goals), words, PATIENCE_S)
        away = await down(field)
    assert watch.least(1.5) > 2.0
    assert max(away.values()) < 1.5, away


async def test_the_planner_dies_and_all_come_home_apart(field: Field) -> None:
    """The last one here: its planner says nothing more."""
    await crossing(field)
    async with field.fleet.watch() as watch:
        await asyncio.sleep(2.5)
        field.agent.context.z.session.close()  # nothing is sent any more, and nothing is given back
        away = await down(field)
    assert watch.moved() > 5.0
    assert watch.least(1.5) > 2.0, "nobody was nearer to another than their radii"
    assert max(away.values()) < 1.5, away
