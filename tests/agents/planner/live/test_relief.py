"""Who runs low on the way goes home, and a fresh one searches on where it stopped; an empty one is refused."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator

import numpy as np
import pytest
import pytest_asyncio
import shapely

from agents.planner.live.relief import left_over, way_of
from tests.agents.planner.live.led import PATIENCE_S, Field, led
from tests.descents import COPTER_DOWN
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.waiting import within
from zmav.wire import swarm

pytestmark = pytest.mark.asyncio(loop_scope="module")
PACK = 20_000.0
"""mAh of a pack that lasts"""
POLYGON = [(5.0, -5.0), (25.0, -5.0), (25.0, 25.0), (5.0, 25.0)]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field() -> AsyncIterator[Field]:
    """Two in the air, one beside them on the ground."""
    places = [(0.0, 0.0), (0.0, 20.0), (0.0, 40.0)]
    async with led(places, 15.0, params={**COPTER_DOWN, "BATT_CAPACITY": PACK}) as field:
        third = field.me.vehicle("quad3")
        with field.fleet.quickly():
            await third.land()
        await third.wait_until(lambda state: state.armed is False and bool(state.ready), PATIENCE_S)
        yield field


async def drained(field: Field, name: str, share: float) -> None:
    """Have its autopilot take what it has used by now for all but so much of its pack."""
    copter = field.fleet.world.vehicles[field.fleet.names.index(name)].brain
    assert isinstance(copter, ArduCopter)

    def fit() -> None:
        copter.params.set("BATT_CAPACITY", max(50.0, round(copter.consumed_mah / (1.0 - share))))

    field.fleet.world.call(fit)
    vehicle = field.me.vehicle(name)
    await vehicle.wait_until(
        lambda s: s.battery is not None and abs((s.battery.remaining or 0.0) - share) < 0.06, PATIENCE_S
    )


@pytest.mark.timeout(240)
async def test_a_searcher_that_runs_low_goes_home_and_a_fresh_one_searches_on(field: Field) -> None:
    names = ["quad1", "quad2"]
    tracks: dict[str, list[tuple[float, float]]] = {name: [] for name in field.fleet.names}

    async def look() -> None:
        while True:
            for name, (north, east, down) in field.fleet.places().items():
                if -down > 12.0:
                    tracks[name].append((east, north))
            await asyncio.sleep(0.1)

    looking = asyncio.create_task(look())
    name = await field.submit(swarm.Search(vehicles=names, polygon=POLYGON, height=15.0, overlap=0.2))
    await field.until(name, lambda entry: entry.state == "flying" and entry.progress > 0.42)
    await drained(field, "quad2", 0.22)
    first = next(entry for entry in field.agent.context.ledger.goals if entry.id == name)
    ledger = field.agent.context.ledger

    async def over() -> None:
        while ledger.open or len(ledger.goals) < 2:
            await asyncio.sleep(0.2)

    await within(4.0 * PATIENCE_S, over())
    looking.cancel()
    assert (
        first.state == "cancelled"
        and "quad2 runs low" in first.text
        and "quad2 returns, and quad3 takes over" in first.text
    ), first
    later = {type(entry.goal).__name__: entry for entry in ledger.goals if entry.id != name}
    assert set(later) == {"Return", "TakeOff", "Search"}, ledger.goals
    assert all(entry.state == "done" for entry in later.values()), ledger.goals
    assert later["Return"].goal.vehicles == ["quad2"]
    assert later["Search"].goal.vehicles == ["quad1", "quad3"] or later["Search"].goal.vehicles == ["quad3"]
    home = field.me.vehicle("quad2").state
    assert home.armed is False
    assert home.local is not None and math.dist(home.local[:2], (0.0, 20.0)) < 2.0
    lines = [shapely.linestrings(track) for track in tracks.values() if len(track) > 1]
    seen = shapely.union_all([shapely.buffer(line, 5.0) for line in lines])
    wanted = shapely.Polygon([(east, north) for north, east in POLYGON])
    assert seen.intersection(wanted).area > 0.98 * wanted.area, "all of it was flown over, by whomever"


async def test_who_could_not_come_back_is_refused_before_it_moves(field: Field) -> None:
    await drained(field, "quad1", 0.12)
    planner = await field.planner()
    there = swarm.GoTo(vehicles=["quad1"], to=[(200.0, 0.0, -15.0)])
    preview = await planner.order("preview", swarm.Preview(goal=there))
    assert "quad1 could not come back" in preview["refused"]
    assert preview["batteries"]["quad1"]["landing"] < 0.2
    place, begun = field.fleet.places()["quad1"], time.monotonic()
    name = await field.submit(there)
    entry = next(entry for entry in field.agent.context.ledger.goals if entry.id == name)
    while entry.state not in ("failed", "done") and time.monotonic() < begun + PATIENCE_S:
        await asyncio.sleep(0.1)
    assert entry.state == "failed" and "reserve of 20 %" in entry.text, entry
    assert math.dist(field.fleet.places()["quad1"], place) < 2.0
    # What is left of a search is refused likewise, and who hovers for it is not left there.
    left = [[(12.0, 0.0, -15.0), (42.0, 0.0, -15.0), (42.0, 5.0, -15.0), (12.0, 5.0, -15.0)] * 8]
    ledger = field.agent.context.ledger
    name = await field.submit(swarm.Search(vehicles=["quad1"], polygon=POLYGON, height=15.0, lanes=left))
    while not any(isinstance(each.goal, swarm.Return) and each.state == "done" for each in ledger.goals[-1:]):
        assert time.monotonic() < begun + 2.0 * PATIENCE_S, ledger.goals
        await asyncio.sleep(0.1)
    assert next(each for each in ledger.goals if each.id == name).state == "failed"
    assert ledger.goals[-1].goal.vehicles == ["quad1"]
    assert field.me.vehicle("quad1").state.armed is False


async def test_what_is_left_of_a_way_begins_where_it_was_left() -> None:
    motion = np.array([[0.0, 0.0, 0.0, 9.0], [10.0, 50.0, 0.0, 9.0], [20.0, 50.0, 50.0, 9.0]])
    rest = left_over(motion, 5.5)
    assert rest[0].tolist() == [5.0, 25.0, 0.0, 9.0]
    assert way_of(rest) == [(0.0, 25.0, -9.0), (0.0, 50.0, -9.0), (50.0, 50.0, -9.0)]
    assert way_of(left_over(motion, 25.0)) != [], "the last half second is flown again"
    assert left_over(motion, 0.2) is motion
    assert way_of(motion[-1:]) == []
