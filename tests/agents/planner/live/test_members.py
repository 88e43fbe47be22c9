"""The planner with credentials: who may ask it for what."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from pathlib import Path

import pytest
import zenoh

import zmav
from agents.planner.cli.asking import find, planners
from agents.planner.cli.watching import until_ended
from agents.planner.live.agent import Agent
from agents.planner.live.context import EVENTS
from agents.planner.live.settings import PlannerSettings
from mesh.credentials.ca import Authority
from tests.conftest import Net
from zmav import keys, wire
from zmav.errors import BadInput, Forbidden, Refused, TimedOut
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.waiting import alongside, within
from zmav.wire import swarm

PATIENCE_S = 30.0


async def test_operators_give_goals_and_viewers_look(net: Net, tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "ca", "alpha")
    folders = {
        name: authority.issue(name, role, out=tmp_path / name)
        for name, role in (("ground", Role.PLANNER), ("ops", Role.OPERATOR), ("eye", Role.VIEWER))
    }
    _, endpoint = net.router()

    def member(name: str) -> zmav.Client:
        settings = SessionSettings(connect=[endpoint], credentials=str(folders[name]))
        return zmav.open(fleet="alpha", settings=settings)

    own = PlannerSettings(name="ground", fleet="alpha", patience=1.0)
    async with member("ground") as z, Agent(z, own) as agent, member("ops") as ops, member("eye") as eye:
        hold = swarm.Submit(goal=swarm.Hold(vehicles=["quad1"]))
        viewer = await within(PATIENCE_S, find(eye))
        assert viewer.name == "ground"
        with pytest.raises(Forbidden, match=r"eye \(viewer\) may not use swarm submit"):
            await viewer.order("submit", hold)
        with pytest.raises(BadInput, match="no vehicle quad1 is known"):  # it is looked at, which is all that it lacks
            await viewer.order("preview", swarm.Preview(goal=hold.goal))
        operator = await within(PATIENCE_S, find(ops))
        with pytest.raises(BadInput, match="no vehicle quad1 is known"):
            await operator.order("submit", hold)
        box = swarm.Box(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, -1.0))
        told = swarm.GiveObstacle(obstacle=swarm.Obstacle(name="hut", t=1.0, what=box))
        with pytest.raises(Forbidden):
            await viewer.order("obstacle", told)
        assert (await operator.order("obstacle", told))["news"]
        assert not (await operator.order("obstacle", told))["news"]
        moved = swarm.Obstacle(name="hut", t=0.5, what=swarm.Box(low=(2.0, 0.0, 0.0), high=(3.0, 1.0, -1.0)))
        with pytest.raises(Refused, match="overtaken: what is known of hut"):  # not taken, so it is not said to be
            await operator.order("obstacle", swarm.GiveObstacle(obstacle=moved))
        assert any("by ops" in event.text for event in agent.context.events)
    async with zmav.open(fleet="alpha", connect=[endpoint]) as stranger:
        assert stranger.member is None  # and nobody is in charge of anything any more


async def test_a_flood_of_refused_orders_leaves_what_happened_in_sight(net: Net, tmp_path: Path) -> None:
    """Each was an event of its own, and pushed all others out of the status that keeps the last thirty."""
    authority = Authority.create(tmp_path / "ca", "alpha")
    folders = {n: authority.issue(n, r, out=tmp_path / n) for n, r in (("ground", Role.PLANNER), ("eye", Role.VIEWER))}
    _, endpoint = net.router()

    def member(name: str) -> zmav.Client:
        return zmav.open(fleet="alpha", settings=SessionSettings(connect=[endpoint], credentials=str(folders[name])))

    async with (
        member("ground") as z,
        member("eye") as eye,
        Agent(z, PlannerSettings(name="ground", fleet="alpha")) as agent,
    ):
        gate, key = agent.handlers.gate, keys.SWARM.key("alpha", "ground", verb="abort")
        assert gate is not None
        await within(PATIENCE_S, find(eye))
        agent.context.say("goal", "notice", "the true news")
        while gate.counts.total() < 2 * EVENTS:
            await asyncio.gather(*(eye.ask(key, wire.encode(swarm.GoalId()), channel=keys.SWARM) for _ in range(20)))
        said = [event.text for event in agent.context.events if event.kind == "refused"]
        assert "the true news" in [event.text for event in agent.context.events]
        assert 0 < len(said) <= EVENTS / 2
        while not any("more before" in text for text in said):
            await eye.ask(key, wire.encode(swarm.GoalId()), channel=keys.SWARM)
            said = [event.text for event in agent.context.events if event.kind == "refused"]


async def test_nobody_takes_charge_without_a_proof(net: Net, tmp_path: Path) -> None:
    """A forged book of a high term, a word that its planner is in charge, a map and an obstacle: by a program on the
    host's loopback, by a viewer, by who replays a planner's own. The planner stays in charge of its own goals.
    """
    authority = Authority.create(tmp_path / "ca", "alpha")
    roles = (("ground", Role.PLANNER), ("second", Role.PLANNER), ("eye", Role.VIEWER))
    folders = {name: authority.issue(name, role, out=tmp_path / name) for name, role in roles}
    _, endpoint = net.router()

    def member(name: str) -> zmav.Client:
        settings = SessionSettings(connect=[endpoint], credentials=str(folders[name]))
        return zmav.open(fleet="alpha", settings=settings)

    goal = swarm.GoalEntry(id="g99-1", goal=swarm.Hold(vehicles=["quad1"]), state="queued", t=1.0)
    box = swarm.Box(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, -1.0))
    book = swarm.Book(t=1.0, planner="evil", instance="ff", term=99, goals=[goal])
    forged = {
        "goal": book,
        "charge": swarm.Charge(t=1.0, planner="evil", instance="ff", term=99),
        "obstacle": swarm.ObstacleMap(
            t=1.0, planner="evil", instance="ff", obstacles=[swarm.Obstacle(name="wall", t=1.0, what=box)]
        ),
    }
    own = PlannerSettings(name="ground", fleet="alpha", patience=1.0)
    async with member("ground") as z, member("eye") as eye, Agent(z, own) as agent:
        assert (z.member, eye.member) != (None, None)
        await within(PATIENCE_S, find(z))
        term, counts = agent.context.charge.term, z.member.counts  # type: ignore[union-attr]
        loopback = net.ground(endpoint).session
        key = {topic: keys.FLEET.key("alpha", topic=topic) for topic in forged}
        for topic, what in forged.items():
            loopback.put(key[topic], wire.encode(what))
        wall = keys.OBSTACLE.key("alpha", name="wall")
        loopback.put(wall, wire.encode(swarm.Obstacle(name="wall", t=1.0, what=box)))
        await counted(counts, "unsigned", 4)
        while counts["role"] < 3:  # of the first, one alone introduces its signer
            for topic, what in forged.items():
                eye.put(keys.FLEET, key[topic], what)
            await asyncio.sleep(0.1)
        async with z.subscribe(key["goal"]) as books:
            recorded = await within(PATIENCE_S, books.get())
        loopback.put(key["goal"], recorded.payload, attachment=recorded.attachment)
        await counted(counts, "replayed", 1)
        assert (agent.context.charge.term, agent.context.charge.highest, agent.context.ledger.goals) == (term, term, [])
        assert agent.context.world.obstacles == []
        async with member("second") as other:  # who may plan is heard, and stands above by its term
            other.put(keys.FLEET, key["goal"], book)
            while agent.context.charge.in_charge:
                await within(PATIENCE_S, asyncio.sleep(0.01))
            assert agent.context.charge.of == "evil"


async def counted(counts: Mapping[str, int], reason: str, least: int) -> None:
    async def wait() -> None:
        while counts.get(reason, 0) < least:
            await asyncio.sleep(0.01)

    await within(PATIENCE_S, wait())


async def test_the_planner_that_is_in_charge_is_asked_and_no_other(net: Net) -> None:
    """Its own word says which one that is; what it refuses with is told."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as ground, zmav.open(connect=[endpoint]) as z:
        charge = keys.FLEET.key("demo", topic="charge")
        status = {"planner": "second", "in_charge": True, "term": 1, "instance": "2"}
        outcome = wire.encode(wire.Outcome(verb="status", status="done", took=0.0, result=status))

        def refuse(query: zenoh.Query) -> None:
            with query:
                query.reply_err(wire.error_body(Refused("busy")))

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(str(query.key_expr), outcome)

        async def says(name: str, term: int) -> None:
            while True:
                told = swarm.Charge(t=time.time(), planner=name, instance=name, term=term)
                ground.session.put(charge, wire.encode(told))
                await asyncio.sleep(0.05)

        there: list[object] = []
        for name, on_query in (("first", refuse), ("second", answer)):
            about = {"role": "planner", "sys": 0, "autopilot": "-", "uid": "-", "instance": name}
            key = keys.SWARM.key("demo", name, verb="status")
            there.append(ground.session.declare_queryable(key, on_query))
            there.append(ground.session.liveliness().declare_token(keys.ALIVE.key("demo", name, **about)))

        async def named() -> None:
            while await planners(z) != ["first", "second"]:
                pass

        await within(PATIENCE_S, named())
        with pytest.raises(Refused, match="first, second: standing by"):
            await within(PATIENCE_S, find(z))
        async with alongside(says("first", 1)):
            with pytest.raises(Refused, match="busy"):
                await within(PATIENCE_S, find(z))
            async with alongside(says("second", 1)):  # whom a rival is heard beside, and gives way to
                for _ in range(3):
                    assert (await within(PATIENCE_S, find(z))).name == "second"
        async with alongside(says("second", 1), says("first", 2)):
            with pytest.raises(Refused, match="busy"):
                await within(PATIENCE_S, find(z))


async def test_one_that_has_stepped_down_is_not_given_as_in_charge(net: Net) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as ground, zmav.open(connect=[endpoint]) as z:
        asked = list[bool]()

        def answer(query: zenoh.Query) -> None:
            asked.append(len(asked) > 0)
            status = {"planner": "ground", "in_charge": asked[-1]}
            with query:
                outcome = wire.Outcome(verb="status", status="done", took=0.0, result=status)
                query.reply(str(query.key_expr), wire.encode(outcome))

        async def says() -> None:
            while True:
                told = swarm.Charge(t=time.time(), planner="ground", instance="1", term=1)
                ground.session.put(keys.FLEET.key("demo", topic="charge"), wire.encode(told))
                await asyncio.sleep(0.05)

        there = ground.session.declare_queryable(keys.SWARM.key("demo", "ground", verb="status"), answer)
        async with alongside(says()):
            assert (await within(PATIENCE_S, find(z))).status["in_charge"]
        assert asked == [False, True]
        there.undeclare()


async def test_a_goal_is_waited_for_by_the_clock_and_not_by_books(net: Net) -> None:
    """A planner with news says its book three times a second, and the first ones may be older than the goal."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as planner, zmav.open(connect=[endpoint]) as z:
        key = keys.FLEET.key(z.fleet_name, topic="goal")
        ended = swarm.GoalEntry(id="g1", goal=swarm.Hold(vehicles=["quad1"]), state="done", t=1.0)
        watching = asyncio.create_task(until_ended(z, "g1", False))
        await net.linked(planner.session, key)
        for goals in [*([] for _ in range(15)), [ended]]:
            book = swarm.Book(t=time.time(), planner="ground", instance="1", term=1, goals=goals)
            planner.session.put(key, wire.encode(book))
            await asyncio.sleep(0.02)
        assert (await asyncio.wait_for(watching, PATIENCE_S)).state == "done"


async def test_a_goal_that_nobody_knows_is_not_waited_for(net: Net) -> None:
    """It was given to a planner that lost its charge, or pushed out of the book by others that ended as it did."""
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as planner, zmav.open(connect=[endpoint]) as z:
        key = keys.FLEET.key(z.fleet_name, topic="goal")

        async def tell() -> None:
            while True:
                book = swarm.Book(t=time.time(), planner="ground", instance="1", term=1)
                planner.session.put(key, wire.encode(book))
                await asyncio.sleep(0.05)

        telling = asyncio.create_task(tell())
        with pytest.raises(TimedOut, match="g1 is not in the book of ground"):
            await within(PATIENCE_S, until_ended(z, "g1", False))
        telling.cancel()
