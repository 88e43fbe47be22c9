"""Orders to several vehicles: who is left out, who brings them home, and that done is done."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
import zenoh

import zmav
from agents.planner.live.agent import Agent
from agents.planner.live.settings import Settings
from tests.agents.planner.execute.fleet import PATIENCE_S, Fleet, airborne
from tests.conftest import endpoint_of
from zmav import keys, wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec, World
from zmav.swarm import FleetOrder, Told
from zmav.wire import swarm

PLACES = [(0.0, 0.0), (0.0, 7.0), (7.0, 0.0)]
HOMEWARD = ("RTL", "LAND")


class Modes:
    """Every mode in which each vehicle was armed, and whether it was armed when an order was said to be done."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.modes: dict[str, set[str]] = {name: set() for name in fleet.names}
        self.told: list[tuple[str, str, bool]] = []

    async def watch(self) -> None:
        while True:
            for name, sim in zip(self.fleet.names, self.fleet.world.vehicles, strict=True):
                self.modes[name].add(sim.status().mode)
            await asyncio.sleep(0.02)

    def tell(self, news: str | Told) -> None:
        if isinstance(news, Told):
            sim = self.fleet.world.vehicles[self.fleet.names.index(news.vehicle)]
            self.told.append((news.vehicle, news.status, sim.status().armed))


@contextlib.asynccontextmanager
async def over(fleet: Fleet) -> AsyncIterator[Modes]:
    modes = Modes(fleet)
    watching = asyncio.create_task(modes.watch())
    try:
        yield modes
    finally:
        watching.cancel()


async def give(fleet: Fleet, modes: Modes, verb: str = "rtl", speed: float = 6.0) -> FleetOrder:
    fleet.world.set_speed(speed)
    order = FleetOrder(fleet.z, [fleet.z.vehicle(name) for name in fleet.names], verb, wire.Order(), modes.tell)
    await order.run()
    return order


async def test_the_disarmed_is_left_out_and_done_is_landed() -> None:
    """Nobody plans: each returns by itself, which is said."""
    async with airborne(PLACES, 5.0) as fleet:
        fleet.world.set_speed(6.0)
        await fleet.z.vehicle("quad3").land()
        before = fleet.world.vehicles[2].status().mode
        async with over(fleet) as modes:
            order = await give(fleet, modes)
        assert sorted(modes.told) == [("quad1", "done", False), ("quad2", "done", False), ("quad3", "left_out", False)]
        assert order.told["demo", "quad3"].text == "left out: it is disarmed"
        assert order.told["demo", "quad1"].text == "done: landed and disarmed"
        assert modes.modes["quad3"] == {before}, "a vehicle on the ground is not told to return"
        (note,) = order.notes
        assert "no planner is in charge of fleet demo" in note and "each returns by itself" in note


async def test_several_are_brought_home_by_the_planner() -> None:
    """The real one: they fly its plan and never the autopilot's own RTL."""
    async with airborne(PLACES, 5.0) as fleet, contextlib.AsyncExitStack() as stack:
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        agent = await stack.enter_async_context(Agent(z, Settings(name="ground", patience=1.0)))
        await agent.solver.until_ready()
        await asyncio.wait_for(_until(lambda: agent.charge.in_charge), PATIENCE_S)
        async with over(fleet) as modes:
            order = await give(fleet, modes, speed=1.0)
        assert order.notes == ["planner ground brings quad1, quad2, quad3 home (" + agent.ledger.goals[-1].id + ")"]
        assert sorted(modes.told) == [(name, "done", False) for name in fleet.names]
        assert not any("RTL" in seen for seen in modes.modes.values())


async def _until(true: Callable[[], bool]) -> None:
    while not true():
        await asyncio.sleep(0.02)


class FakePlanner:
    """In charge by its word; ``answers``: how it takes a goal, ``entry``: what its book says of it."""

    def __init__(self, session: zenoh.Session, answers: bytes | Exception | None, entry: str | None) -> None:
        self._session, self._answers, self._entry = session, answers, entry
        self.asked: list[str] = []
        self._queryable = session.declare_queryable(keys.SWARM.key("demo", "fake", verb="*"), self._on_query)
        self._task = asyncio.create_task(self._speak())

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            verb = str(query.key_expr).rpartition("/")[2]
            self.asked.append(verb)
            if isinstance(self._answers, zmav.ZmavError):
                query.reply_err(wire.error_body(self._answers))
            elif isinstance(self._answers, bytes):
                query.reply(str(query.key_expr), self._answers)

    async def _speak(self) -> None:
        while True:
            charge = swarm.Charge(t=time.time(), planner="fake", instance="1", term=1)
            self._session.put(keys.FLEET.key("demo", topic="charge"), wire.encode(charge))
            goal = swarm.Return(vehicles=["quad1"])
            states: Any = [self._entry] if self._entry else []
            entries = [swarm.GoalEntry(id="g1", goal=goal, state=each, t=1.0, text="no way") for each in states]
            book = swarm.Book(t=time.time(), planner="fake", instance="1", term=1, goals=entries)
            self._session.put(keys.FLEET.key("demo", topic="goal"), wire.encode(book))
            await asyncio.sleep(0.2)

    def close(self) -> None:
        self._task.cancel()
        self._queryable.undeclare()


TAKEN = wire.encode(wire.Outcome(verb="submit", status="done", took=0.0, result={"goal": "g1"}))


@pytest.mark.parametrize(
    ("answers", "entry", "words"),
    [
        (None, None, "planner fake does not answer"),
        (zmav.errors.Refused("it stands by"), None, "it stands by"),
        (TAKEN, "failed", "fake: no way"),
        (TAKEN, "planning", "fake has not begun"),
        (TAKEN, None, "fake has not begun"),
        (b"no JSON", None, "not JSON"),
    ],
    ids=["silent", "refuses", "fails", "never begins", "tells nothing", "garbage"],
)
async def test_a_planner_that_does_not_fly_holds_up_nobody(
    answers: bytes | Exception | None, entry: str | None, words: str
) -> None:
    async with airborne(PLACES[:2], 3.0) as fleet:
        session = open_session(SessionSettings(connect=[fleet.endpoint]))
        fake = FakePlanner(session, answers, entry)
        order = FleetOrder(fleet.z, [fleet.z.vehicle(name) for name in fleet.names], "rtl", wire.Order())
        task = asyncio.create_task(order.run())
        await asyncio.wait_for(_until(lambda: _homeward(fleet)), PATIENCE_S)
        fleet.world.set_speed(8.0)
        told = await task
        fake.close()
        session.close()
        assert [each.status for each in told] == ["done", "done"]
        assert words in order.notes[0] and "each returns by itself" in order.notes[0]
        if answers == TAKEN and entry != "failed":
            await asyncio.wait_for(_until(lambda: "cancel" in fake.asked), PATIENCE_S)


def _homeward(fleet: Fleet) -> bool:
    return all(sim.status().mode in HOMEWARD for sim in fleet.world.vehicles)


async def test_what_ends_in_circles_is_not_said_to_be_done() -> None:
    """A plane, which does not land by itself, and a vehicle that refuses; a rover cannot land."""
    specs = [VehicleSpec(autopilot="arduplane"), VehicleSpec(autopilot="ardurover", start_ned_m=(0.0, 9.0, 0.0))]
    router = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", speed=6.0, ready_s=0.5))
        session = stack.enter_context(open_session(router))
        for name, url in zip(("plane1", "rover1"), world.urls, strict=True):
            await stack.enter_async_context(Onboard(session, OnboardSettings(link=url, name=name)))
        z = await stack.enter_async_context(zmav.open(connect=[endpoint_of(session)]))
        plane, rover = await z.wait_for("plane1", "rover1", timeout=PATIENCE_S)
        for vehicle in (plane, rover):
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), PATIENCE_S)
            await vehicle.arm()
        await plane.takeoff(40.0)
        told = {each.vehicle: each for each in await FleetOrder(z, [plane, rover], "rtl", wire.Order()).run()}
        assert told["plane1"].text == "in RTL, circling; it stays armed"
        assert told["rover1"].text == "in RTL, on its way home; it stays armed"
        assert told["plane1"].result["armed"] is True
        (left, *_) = await FleetOrder(z, [rover, plane], "land", wire.Order()).run()
        assert (left.status, left.text) == ("left_out", "left out: a rover does not land")
        await rover.disarm()
        await rover.wait_until(lambda s: s.armed is False, PATIENCE_S)
        (left,) = await FleetOrder(z, [rover], "rtl", wire.Order()).run()
        assert (left.status, left.text) == ("left_out", "left out: it is disarmed")
