"""Several are to return: who is stopped and when, whom a plan brings home, and what is done where it fails half-way."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, NamedTuple

import pytest

import zmav
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from tests.agents.planner.execute.fleet import PATIENCE_S, ROUTER, airborne
from tests.conftest import Samples, endpoint_of
from tests.swarm import TAKEN, FakePlanner, FakeVehicle
from zmav import keys, wire
from zmav.errors import NotHolder, Refused
from zmav.session import SessionSettings, open_session
from zmav.swarm import FleetOrder, VehicleProgress
from zmav.wire.swarm import GoalState


class Scene(NamedTuple):
    """A planner, vehicles, and an order to them all that is under way."""

    planner: FakePlanner
    vehicles: list[FakeVehicle]
    order: FleetOrder
    handles: Sequence[zmav.Vehicle]
    news: list[str | VehicleProgress]
    changed: asyncio.Event

    def status(self, name: str) -> str:
        return self.order.told["demo", name].status

    async def until(self, true: Callable[[], bool]) -> None:
        """Wait until it holds; it is looked at after each news of the order."""
        while not true():
            self.changed.clear()
            await asyncio.wait_for(self.changed.wait(), PATIENCE_S)

    @property
    def notes(self) -> str:
        return "; ".join(self.order.notes)


@contextlib.asynccontextmanager
async def scene(
    entry: GoalState | None, *unlike: dict[str, Any], answers: bytes | Exception | None = TAKEN
) -> AsyncIterator[Scene]:
    """Two vehicles that a planner can bring home, and one more for each of ``unlike``."""
    async with contextlib.AsyncExitStack() as stack:
        session = stack.enter_context(open_session(ROUTER))
        states = [{}, {}, *unlike]
        vehicles = [FakeVehicle(session, f"quad{i + 1}", **state) for i, state in enumerate(states)]
        planner = FakePlanner(session, answers, entry)
        stack.callback(planner.close)
        for vehicle in vehicles:
            stack.callback(vehicle.close)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint_of(session)]))
        known = await z.wait_for(*(fake.name for fake in vehicles), timeout=PATIENCE_S)
        news, changed = list[str | VehicleProgress](), asyncio.Event()

        def hear(what: str | VehicleProgress) -> None:
            news.append(what)
            changed.set()

        yield Scene(planner, vehicles, FleetOrder(z, known, "rtl", wire.Order(), hear), known, news, changed)


def land(vehicle: FakeVehicle) -> None:
    vehicle.state.armed, vehicle.state.landed = False, True


# Who flies somewhere is stopped at once.


async def stream(vehicle: zmav.Vehicle, flying: asyncio.Event) -> None:
    """Away from home as fast as it goes, until somebody takes it."""
    async with vehicle.lease("away") as lease:
        with contextlib.suppress(NotHolder):
            while True:
                lease.setpoint(vel=(4.0, 0.0, 0.0))
                if vehicle.state.mode == "OFFBOARD":
                    flying.set()
                await asyncio.sleep(0.05)


def modes(events: Samples, name: str) -> list[str]:
    """What each event said that the vehicle's mode is from then on."""
    return [
        body["detail"]["mode"]
        for (key, _), body in zip(events.items, events.objects(), strict=True)
        if f"/{name}/" in key and body["kind"] == "mode"
    ]


def _held(events: Samples, names: Sequence[str]) -> bool:
    return all("HOLD" in modes(events, name) for name in names)


async def test_who_flies_somewhere_is_stopped_at_once() -> None:
    """It holds while no planner has said a word. On PX4 that is a mode, which the events tell in its order."""
    async with airborne([(0.0, 0.0), (0.0, 9.0)], 6.0, autopilot="px4") as fleet:
        session = open_session(SessionSettings(connect=[fleet.endpoint]))
        for slow in (False, True):  # no planner at all; one that is silent
            events = Samples(session, keys.EVENT.key("demo", "*"))
            flying = [asyncio.Event() for _ in fleet.names]
            streams = [
                asyncio.create_task(stream(fleet.z.vehicle(name), event))
                for name, event in zip(fleet.names, flying, strict=True)
            ]
            await asyncio.wait_for(asyncio.gather(*(event.wait() for event in flying)), PATIENCE_S)
            fake = FakePlanner(session, None) if slow else None
            order = FleetOrder(fleet.z, [fleet.z.vehicle(name) for name in fleet.names], "rtl", wire.Order())
            order.look = order.answer = PATIENCE_S  # a busy machine is no dead planner
            task = asyncio.create_task(order.run())
            await events.until(functools.partial(_held, events, fleet.names), "hold of each")
            assert not order.notes, "nobody has answered so far"
            await asyncio.gather(*streams)
            if fake is not None:
                await fake.told("submit")
                fake.close()
            task.cancel()
            for name in fleet.names:
                seen = modes(events, name)
                assert seen[: seen.index("HOLD")][-1] == "OFFBOARD", "nothing came between its way and the hold"
                assert "RTL" not in seen
        session.close()


async def test_the_planner_brings_home_who_was_stopped_for_it() -> None:
    """The real one, and copters on their way elsewhere: neither its leases nor its patience suffer from the hold."""
    async with airborne([(0.0, 0.0), (0.0, 9.0)], 6.0) as fleet, contextlib.AsyncExitStack() as stack:
        z = await stack.enter_async_context(zmav.open(connect=[fleet.endpoint]))
        agent = await stack.enter_async_context(Agent(z, PlannerSettings(name="ground", patience=1.0)))
        await agent.context.solver.until_ready()
        await asyncio.wait_for(_until(lambda: agent.context.charge.in_charge), PATIENCE_S)
        away = [asyncio.create_task(fleet.z.vehicle(name).goto(pos=(150.0, 0.0, -6.0))) for name in fleet.names]
        await asyncio.wait_for(
            _until(lambda: all(sim.status().speed_mps > 2.0 for sim in fleet.world.vehicles)), PATIENCE_S
        )
        events = Samples(fleet.z.session, keys.EVENT.key("demo", "*"))
        done = list[tuple[str, str, bool]]()

        def tell(news: str | VehicleProgress) -> None:
            if isinstance(news, str):
                fleet.world.set_speed(4.0)  # the planner has them: what is left is its flight
            elif news.status == "done":
                sim = fleet.world.vehicles[fleet.names.index(news.vehicle)]
                done.append((news.vehicle, news.text, sim.status().armed))

        order = FleetOrder(fleet.z, [fleet.z.vehicle(name) for name in fleet.names], "rtl", wire.Order(), tell)
        await order.run()
        (goal,) = agent.context.ledger.goals
        assert order.notes == [f"planner ground brings quad1, quad2 home ({goal.id})"]
        assert sorted(done) == [(name, "done: landed and disarmed", False) for name in fleet.names]
        ended = await asyncio.gather(*away, return_exceptions=True)
        assert all(isinstance(each, Refused) and "superseded" in each.message for each in ended)
        assert goal.state == "done", goal.text
        await events.until(lambda: all("LAND" in modes(events, name) for name in fleet.names), "the landing of each")
        assert not any("RTL" in modes(events, name) for name in fleet.names)


async def _until(true: Callable[[], bool]) -> None:
    while not true():
        await asyncio.sleep(0.02)


async def test_the_hold_does_not_wait_for_the_planner_nor_the_planner_for_it() -> None:
    async with scene("planning", answers=None) as s:
        for vehicle in s.vehicles:
            vehicle.orders = lambda verb: None if verb == "hold" else {"mode": "RTL", "armed": False}
        task = asyncio.create_task(s.order.run())
        await asyncio.gather(s.planner.told("submit"), *(vehicle.ordered("hold") for vehicle in s.vehicles))
        await task
        assert [vehicle.verbs[0] for vehicle in s.vehicles] == ["hold", "hold"]
        assert [vehicle.verbs[-1] for vehicle in s.vehicles] == ["rtl", "rtl"]


# Whom a plan brings home.


@pytest.mark.parametrize(
    ("state", "why"),
    [
        ({"pilot": "the pilot's switch is in its way"}, "the pilot's switch is in its way"),
        ({"connected": False, "armed": None}, "its autopilot is not heard"),
        ({"local": None}, "it does not say where it is in the fleet's frame"),
        ({"landed": True}, "it stands on the ground"),
    ],
    ids=["pilot", "autopilot silent", "no place", "landed"],
)
async def test_who_cannot_be_planned_for_returns_by_itself_at_once(state: dict[str, Any], why: str) -> None:
    async with scene("planning", state) as s:
        task = asyncio.create_task(s.order.run())
        await s.vehicles[2].ordered("rtl")
        await s.planner.told("submit")
        assert s.planner.wanted == ["quad1", "quad2"]
        assert s.vehicles[2].verbs == ["rtl"]
        assert f"quad3 returns by itself: {why}" in s.order.notes
        assert "rtl" not in s.vehicles[0].verbs
        task.cancel()


async def test_who_is_not_heard_any_more_is_not_planned_for() -> None:
    async with scene("planning", {}) as s:
        s.vehicles[2].silent = True
        limit = keys.STATE.stale_after or 0.0
        order = s.order
        await asyncio.wait_for(_until(lambda: (s.handles[2].age or 0.0) > limit), PATIENCE_S)
        task = asyncio.create_task(order.run())
        await asyncio.gather(s.vehicles[2].ordered("rtl"), s.planner.told("submit"))
        assert s.planner.wanted == ["quad1", "quad2"]
        assert "quad3 returns by itself: it is not heard" in order.notes
        task.cancel()


async def test_one_alone_is_planned_for_by_nobody() -> None:
    async with scene("planning", {}) as s:
        for vehicle in s.vehicles[1:]:
            land(vehicle)
        await asyncio.wait_for(
            _until(lambda: all(v.last_state and not v.last_state.armed for v in s.handles[1:])), PATIENCE_S
        )
        told = await s.order.run()
        assert [each.status for each in told] == ["done", "left_out", "left_out"]
        assert (s.vehicles[0].verbs, s.planner.asked) == (["rtl"], [])


async def test_who_disarms_before_the_order_comes_is_left_out() -> None:
    """By its own word, with its reason; any other refusal is a failure."""
    async with scene(None, answers=None) as s:

        def refuse(verb: str) -> dict[str, Any]:
            raise Refused("it is disarmed: there is nothing to bring back", reason="disarmed")

        def unready(verb: str) -> dict[str, Any]:
            raise Refused("no position")

        s.vehicles[0].orders, s.vehicles[1].orders = refuse, unready
        told = await s.order.run()
        assert [(each.status, each.text, each.error) for each in told] == [
            ("left_out", "left out: it is disarmed", ""),
            ("failed", "no position", "refused"),
        ]


# What is done where no plan comes, or where one fails half-way.


@pytest.mark.parametrize(
    ("answers", "entry", "words"),
    [
        (None, None, "planner fake does not answer"),
        (Refused("it stands by"), None, "it stands by"),
        (TAKEN, "failed", "fake: no way"),
        (TAKEN, "planning", "fake has no plan after"),
        (TAKEN, None, "fake has not begun"),
        (b"no JSON", None, "not JSON"),
    ],
    ids=["silent", "refuses", "fails", "never flies", "tells nothing", "garbage"],
)
async def test_a_planner_that_does_not_fly_holds_up_nobody(
    answers: bytes | Exception | None, entry: GoalState | None, words: str
) -> None:
    async with scene(entry, answers=answers) as s:
        s.order.plan = 2.0
        told = await asyncio.wait_for(s.order.run(), PATIENCE_S)
        if answers == TAKEN and entry != "failed":
            await s.planner.told("cancel")
        assert [(each.status, each.text) for each in told] == [("done", "done: landed and disarmed")] * 2
        assert [vehicle.verbs for vehicle in s.vehicles] == [["hold", "rtl"]] * 2
        assert words in s.order.notes[0] and "each returns by itself" in s.order.notes[0]


async def test_a_late_plan_is_cancelled_before_the_order_has_ended() -> None:
    """Whoever gave it may be gone then, and with him what was not sent yet."""
    async with scene("planning") as s:
        s.order.plan = 1.0
        task = asyncio.create_task(s.order.run())
        await asyncio.gather(s.planner.told("submit"), *(vehicle.ordered("hold") for vehicle in s.vehicles))
        for vehicle in s.vehicles:
            land(vehicle)
        await task
        assert "cancel" in s.planner.asked
        assert "has no plan after" in s.notes


@pytest.mark.parametrize(
    ("how", "words"), [("failed", "fake: no way"), ("silent", "planner fake is silent")], ids=["fails", "dies"]
)
async def test_a_plan_that_fails_half_way_leaves_nobody_behind(how: str, words: str) -> None:
    """Who has landed is done; who has not returns by itself."""
    async with scene("planning") as s:
        task = asyncio.create_task(s.order.run())
        await asyncio.gather(s.planner.told("submit"), *(vehicle.ordered("hold") for vehicle in s.vehicles))
        s.planner.entry = "flying"
        await s.until(lambda: "planner fake brings quad1, quad2 home" in s.notes)
        assert [s.status("quad1"), s.status("quad2")] == ["returning", "returning"]
        land(s.vehicles[0])
        await s.until(lambda: s.status("quad1") == "done")
        s.planner.entry, s.planner.silent = ("failed", False) if how == "failed" else ("flying", True)
        told = await asyncio.wait_for(task, PATIENCE_S)
        assert [(each.vehicle, each.status) for each in told] == [("quad1", "done"), ("quad2", "done")]
        assert (s.vehicles[0].verbs, s.vehicles[1].verbs) == (["hold"], ["hold", "rtl"])
        assert words in s.notes and "each returns by itself" in s.notes


async def test_a_later_order_is_not_overruled() -> None:
    """The planner fails because somebody told one of its vehicles to hold: that one holds, the other returns."""
    async with scene("planning") as s:
        task = asyncio.create_task(s.order.run())
        await asyncio.gather(s.planner.told("submit"), *(vehicle.ordered("hold") for vehicle in s.vehicles))
        s.planner.entry = "flying"
        await s.until(lambda: bool(s.order.notes))
        text = "lease of fake revoked: hold was ordered"
        s.vehicles[0].state.lease_end = wire.LeaseEnd(
            t=time.time() + 1.0, number=3, holder="fake", reason="revoked", text=text
        )
        await asyncio.wait_for(_until(lambda: bool(s.handles[0].state.lease_end)), PATIENCE_S)
        s.planner.entry = "failed"
        told = await asyncio.wait_for(task, PATIENCE_S)
        assert [(each.status, each.text) for each in told] == [
            ("failed", f"not brought home: {text}"),
            ("done", "done: landed and disarmed"),
        ]
        assert s.vehicles[0].verbs == ["hold"]


async def test_a_lease_that_our_own_hold_has_ended_is_nobodys_later_word() -> None:
    """Its end is told after the hold was done: each returns all the same."""
    async with scene("planning") as s:
        task = asyncio.create_task(s.order.run())
        await asyncio.gather(s.planner.told("submit"), *(vehicle.ordered("hold") for vehicle in s.vehicles))
        s.vehicles[0].state.lease_end = wire.LeaseEnd(
            t=time.time() + 1.0, number=3, holder="boss", reason="revoked", text="lease of boss revoked"
        )
        await asyncio.wait_for(_until(lambda: bool(s.handles[0].state.lease_end)), PATIENCE_S)
        s.planner.entry = "failed"
        told = await asyncio.wait_for(task, PATIENCE_S)
        assert [each.status for each in told] == ["done", "done"]
        assert s.vehicles[0].verbs == ["hold", "rtl"]


async def test_who_cancels_the_return_is_obeyed() -> None:
    async with scene("flying") as s:
        task = asyncio.create_task(s.order.run())
        await s.until(lambda: "brings quad1, quad2 home" in s.notes)
        s.planner.entry = "cancelled"
        told = await asyncio.wait_for(task, PATIENCE_S)
        assert [each.status for each in told] == ["failed", "failed"]
        assert (
            told[0].text == "g1 was cancelled: no way; it is still armed: give it rtl alone, and it returns by itself"
        )
        assert "rtl" not in s.vehicles[0].verbs


async def test_a_plan_is_not_given_up_while_it_is_made_again_or_paused() -> None:
    """What bounds the time until a plan is flown does not bound what comes after."""
    async with scene("flying") as s:
        s.order.plan = 0.0
        task = asyncio.create_task(s.order.run())
        await s.until(lambda: "brings quad1, quad2 home" in s.notes)
        states: tuple[GoalState, ...] = ("planning", "paused", "queued")
        key = keys.FLEET.key("demo", topic="goal")
        books = Samples(s.planner.session, key)
        for state in states:
            s.planner.entry = state
            await books.object(functools.partial(_says, state), f"book: {state}")
        for vehicle in s.vehicles:
            land(vehicle)
        s.planner.entry = "done"
        told = await asyncio.wait_for(task, PATIENCE_S)
        assert [each.status for each in told] == ["done", "done"]
        assert [vehicle.verbs for vehicle in s.vehicles] == [["hold"], ["hold"]]


def _says(state: GoalState, book: dict[str, Any]) -> bool:
    return bool(book["goals"][0]["state"] == state)
