"""Goals that are paused, and what goes wrong meanwhile; and one of whose vehicles is taken on the way."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from agents.planner.live.leased_vehicles import LeasedVehicles
from agents.planner.live.run import Run
from tests.agents.planner.live.led import PATIENCE_S, Field, led
from tests.waiting import until
from zmav.wire import swarm

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field() -> AsyncIterator[Field]:
    async with led([(0.0, 0.0), (0.0, 8.0)], 10.0) as field:
        yield field


async def test_who_is_taken_from_a_prepared_flight_keeps_nobody_from_its_end(field: Field) -> None:
    """The others go on without it."""
    names = ["quad1", "quad2"]
    line = swarm.Formation(
        vehicles=names, shape="line", at=(28.0, 4.0, -10.0), via=[(8.0, 4.0, -10.0)], spacing=8.0, labelled=True
    )
    name = await field.submit(line)
    await field.until(name, lambda entry: entry.state == "flying" and "on its way" in entry.text)
    run = field.agent.runs[name]
    await until(lambda: run.flying is not None and field.fleet.places()["quad1"][0] > 12.0, run.entry, PATIENCE_S)
    async with field.me.vehicle("quad1").lease("boss", priority=50) as lease:
        with pytest.raises(AssertionError, match="the others are there; without quad1"):
            await field.until(name, lambda entry: entry.state == "done")
        assert lease.lost is None
    north, _, down = field.fleet.places()["quad2"]
    assert (north, down) == pytest.approx((28.0, -10.0), abs=1.5)


async def at_rest_in_a_pause(field: Field, name: str) -> Run:
    """A goal that flies is paused, and something goes wrong once its vehicle rests."""
    run = field.agent.runs[name]
    await until(lambda: run.flying is not None, "it is not flown", PATIENCE_S)
    await (await field.planner()).order("pause", swarm.GoalId(goal=name))
    assert isinstance(run.flying, LeasedVehicles)
    executor = run.flying
    await until(lambda: executor.phase != "flying", "it does not come to rest", PATIENCE_S)
    executor.halt(f"a gust during {name}")
    return run


async def test_a_goal_that_went_wrong_in_a_pause_can_be_cancelled(field: Field) -> None:
    """Its new plan waits for the pause to end, which it never does."""
    n, e, d = field.fleet.places()["quad1"]
    name = await field.submit(swarm.GoTo(vehicles=["quad1"], to=[(n + 40.0, e, d)]))
    await field.until(name, lambda entry: entry.state == "flying" and entry.progress > 0.02)
    await at_rest_in_a_pause(field, name)
    words, events = f"planned again: a gust during {name}", field.agent.context.events
    await until(lambda: any(words in event.text for event in events), "no plan is asked for", PATIENCE_S)
    await (await field.planner()).order("cancel", swarm.GoalId(goal=name))
    await until(lambda: name not in field.agent.runs, "it waits for ever", PATIENCE_S)
    await field.me.vehicle("quad1").wait_until(lambda state: state.lease is None, PATIENCE_S)


async def test_a_pause_ends_too_while_the_next_plan_is_made(field: Field) -> None:
    n, e, d = field.fleet.places()["quad1"]
    there = (n + 15.0, e, d)
    line = swarm.Formation(vehicles=["quad1"], shape="line", at=there, via=[(n, e, d - 3.0)])
    name = await field.submit(line)
    await field.until(name, lambda entry: entry.state == "flying" and "on its way" in entry.text)
    run = await at_rest_in_a_pause(field, name)
    await until(lambda: run.flying is None, "it is flown on", PATIENCE_S)
    run.resume()
    await field.until(name, lambda entry: entry.state == "done")
    assert field.away("quad1", there) < 1.0
