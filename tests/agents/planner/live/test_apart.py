"""Room for those who rest too near to each other: where they go, and that goals begin with it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator

import msgspec
import numpy as np
import pytest
import pytest_asyncio

from agents.planner.goals.steps import FleetView, VehicleView
from agents.planner.live.accuracy import Accuracies
from agents.planner.live.apart import Surroundings, apart, free
from agents.planner.live.plan import Planner
from agents.planner.live.preview import preview
from agents.planner.live.tally import Tally
from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.scene import Box
from tests.agents.planner.execute.fleet import Fleet
from tests.agents.planner.live.led import Field, led
from tests.waiting import until
from zmav import keys, wire
from zmav.config import Separation, body_of
from zmav.wire import swarm
from zmav.wire.swarm import Beacon

PATIENCE_S = 60.0
PLACES, WIDE = [(0.0, 0.0), (0.0, 2.2)], [(0.0, 0.0), (0.0, 12.0)]
PILLAR = Box(min=(-1.0, -1.0, 0.0), max=(1.0, 1.0, 30.0))


def least(places: Floats, downwash: float) -> float:
    at = places / np.array([1.0, 1.0, downwash])
    gaps = np.linalg.norm(at[:, None, :] - at[None, :, :], axis=2)
    np.fill_diagonal(gaps, np.inf)
    return float(gaps.min())


def test_a_heap_of_vehicles_draws_apart_and_the_others_stay() -> None:
    rng = np.random.default_rng(0)
    heap, far = rng.uniform(18.5, 21.5, (8, 3)), np.array([[50.0, 20.0, 20.0]])
    places, radii = np.vstack((heap, far)), np.full(9, 1.3)
    around = Surroundings([], [], 1.5)
    assert free(places, radii, around).min() < 0.0
    found = apart(places, radii, around)
    assert found is not None
    assert least(found, 1.5) >= 2.6
    assert np.linalg.norm(found - places, axis=1).max() < 6.0
    assert np.array_equal(found[8], far[0])


def test_in_one_place_level_ones_leave_it_on_their_level_and_walls_and_movers_are_kept_clear_of() -> None:
    places = np.array([[2.0, 0.0, 5.0], [2.0, 0.0, 5.0], [2.1, 0.1, 5.0]])
    radii = np.full(3, 1.5)
    around = Surroundings([PILLAR], [MovingObstacle("guest", np.array([[0.0, 4.0, 0.0, 5.0]]), 0.5)], 1.5)
    found = apart(places, radii, around)
    assert found is not None
    assert free(found, radii, around).min() >= 0.0
    assert np.array_equal(found[:, 2], places[:, 2])


def test_where_there_is_no_room_there_are_no_places() -> None:
    cell = [
        Box(min=low, max=high)
        for low, high in (
            ((-30.0, 2.0, 0.0), (30.0, 30.0, 30.0)),
            ((-30.0, -30.0, 0.0), (30.0, -2.0, 30.0)),
            ((2.0, -30.0, 0.0), (30.0, 30.0, 30.0)),
            ((-30.0, -30.0, 0.0), (-2.0, 30.0, 30.0)),
        )
    ]
    places = np.array([[0.0, 0.5, 5.0], [0.0, -0.5, 5.0]])
    assert apart(places, np.full(2, 1.5), Surroundings(cell, [], 1.5)) is None


def test_room_is_half_of_what_two_share_and_all_of_what_a_wall_leaves() -> None:
    places = np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0], [9.0, 0.0, 5.0]])
    around = Surroundings([Box(min=(10.2, -5.0, 0.0), max=(11.0, 5.0, 30.0))], [], 1.0)
    assert free(places, np.ones(3), around) == pytest.approx([0.5, 0.5, 0.2])
    assert free(places[:1], np.ones(1), Surroundings([], [], 1.0)) == pytest.approx([math.inf])


# Flown.


async def given(field: Field, *to: wire.Vector) -> swarm.GoalEntry:
    goal = swarm.GoTo(vehicles=[f"quad{i + 1}" for i in range(len(to))], to=list(to))
    return field.agent.context.ledger.find(await field.submit(goal))[0]


def said(field: Field, kind: str, since: float = 0.0) -> list[str]:
    return [event.text for event in field.agent.context.events if event.kind == kind and event.t >= since]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pair() -> AsyncIterator[Field]:
    async with led(WIDE, 10.0, separation=Separation(on=True)) as pair:
        yield pair


@pytest_asyncio.fixture
async def near() -> AsyncIterator[Field]:
    """2.2 m apart: fewer than even a slow plan keeps."""
    async with led(PLACES, 10.0, separation=Separation(on=True)) as pair:
        yield pair


async def test_two_that_rest_too_near_to_each_other_draw_apart_and_then_fly(near: Field) -> None:
    pair = near
    goal = swarm.GoTo(vehicles=["quad1", "quad2"], to=[(12.0, 8.0, -10.0), (12.0, 0.0, -10.0)])
    told = await (await pair.planner()).order("preview", swarm.Preview(goal=goal))
    first, then = told["steps"]
    assert first["text"].startswith("first they draw apart")
    assert math.dist(*(track[-1][1:3] for track in first["tracks"].values())) > 2.2
    assert told["seconds"] == pytest.approx(first["seconds"] + then["seconds"], abs=0.2)
    async with pair.fleet.watch() as watch:
        await pair.until(await pair.submit(goal), lambda entry: entry.state == "done")
        assert watch.least(1.5) > 2.1, "never nearer than they were"
    (text,) = said(pair, "room")
    assert "draw apart" in text
    assert math.dist(pair.fleet.places()["quad1"], (12.0, 8.0, -10.0)) < 1.0


@pytest.mark.asyncio(loop_scope="module")
async def test_a_takeoff_from_crowded_pads_is_previewed_as_it_is_flown(pair: Field) -> None:
    """One above the other, by what two need, is nearer than any plan keeps for positions: first they draw apart."""
    context = pair.agent.context
    body = msgspec.structs.replace(body_of("copter"), radius=1.0 + 0.5 + 2.5)
    pads = {f"new{i}": (80.0, 4.0 * i, 0.0) for i in range(4)}
    view = FleetView(
        {name: VehicleView(name, "copter", body, pad, home_ned=pad, room=2.5) for name, pad in pads.items()}
    )
    goal = swarm.TakeOff(vehicles=list(pads), height=12.0)
    tally = Tally(goal.vehicles, view)
    told = await preview(Planner(context, "preview", context.solver), goal, view, tally, ())
    kinds = [(step["step"], step["text"].startswith("first they draw apart")) for step in told["steps"]]
    assert kinds == [("Orders", False), ("PlanTo", True), ("PlanTo", False)]
    ends = np.array([track[-1][1:] for track in told["steps"][-1]["tracks"].values()])
    assert least(ends, 1.5) >= 2.0 * (1.0 + 2.5), "with room for all at the end"
    assert {part.flies for part in tally.parts.values()} == {True}


@pytest.mark.asyncio(loop_scope="module")
async def test_who_was_moved_aside_by_itself_is_taken_along_again(pair: Field) -> None:
    """Its last resort sees somebody in its way whom no planner knows."""
    begun, (_, start, _) = time.time(), pair.fleet.places()["quad1"]
    goal = (0.0, start - 30.0, -10.0)
    entry = await given(pair, goal)
    async with pair.fleet.watch() as watch:
        await watch.until(lambda: pair.fleet.places()["quad1"][1] < start - 6.0, "it flies")
        north, east, down = pair.fleet.places()["quad1"]
        while not said(pair, "halt", begun):
            ghost = Beacon(t=time.time(), pos=(north, east - 9.0, down), vel=(0.0, 0.0, 0.0), radius=1.0)
            pair.me.session.put(keys.BEACON.key("demo", "ghost"), wire.encode(ghost))
            await asyncio.sleep(0.1)
    assert "flies no trajectory of ours" in said(pair, "halt", begun)[0]
    await pair.until(entry.id, lambda entry: entry.state == "done")
    assert math.dist(pair.fleet.places()["quad1"], goal) < 1.0


class Faulty(Accuracies):
    """Fails as soon as a vehicle has begun to move."""

    def __init__(self, fleet: Fleet) -> None:
        super().__init__()
        self._fleet, self._from = fleet, fleet.places()["quad1"][1]

    def error(self, name: str) -> float:
        if self._fleet.places()["quad1"][1] < self._from - 3.0:
            raise LookupError("oops")
        return super().error(name)


@pytest.mark.asyncio(loop_scope="module")
async def test_nothing_is_flown_that_is_not_watched(pair: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair.agent.context.fleet, "accuracies", Faulty(pair.fleet))
    north, start, _ = pair.fleet.places()["quad1"]
    entry = await given(pair, (north, start - 40.0, -10.0))
    await until(lambda: entry.state == "failed", entry, PATIENCE_S)
    assert "the planner's own fault: LookupError('oops')" in entry.text
    state = await pair.me.vehicle("quad1").wait_until(lambda s: s.lease is None, PATIENCE_S)
    assert state.local is not None
    assert -30.0 < state.local[1] - start < -3.0, "it came to rest on its way"
