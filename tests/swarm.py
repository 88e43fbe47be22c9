"""Vehicles and a planner as their keys show them: they do what a test tells them, and nothing else."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import zenoh

from tests.conftest import PATIENCE_S
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.waiting import on_loop
from zmav.wire import swarm

EVERY = 0.1
"""s between two words of a vehicle's, of a planner's on its charge, and of its book"""
GOAL = "g1"


class FakeVehicle:
    """In the air and at rest until a test says otherwise: ``state`` is said again and again, ``verbs`` were ordered.

    ``orders(verb)`` gives an order's outcome, or raises what it is refused with; None: there is no answer.
    """

    def __init__(self, session: zenoh.Session, name: str, **state: Any) -> None:
        self.name, self.verbs, self.silent = name, list[str](), False
        self.orders: Callable[[str], dict[str, Any] | None] = lambda verb: {"mode": verb.upper(), "armed": False}
        self.state = wire.VehicleState(
            **{
                "t": 0.0,
                "fleet": "demo",
                "name": name,
                "instance": name,
                "connected": True,
                "kind": "copter",
                "armed": True,
                "landed": False,
                "mode": "GUIDED",
                "local": (0.0, 0.0, -5.0),
                **state,
            }
        )
        self.session, self._news = session, asyncio.Event()
        heard = on_loop(asyncio.get_running_loop(), self._on_query)
        self._queryable = session.declare_queryable(keys.DO.key("demo", name, verb="*"), heard)
        self._task = asyncio.create_task(self._speak())

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            verb = str(query.key_expr).rpartition("/")[2]
            self.verbs.append(verb)
            self._news.set()
            try:
                result = self.orders(verb)
            except ZmavError as e:
                query.reply_err(wire.error_body(e))
                return
            if result is not None:
                outcome = wire.Outcome(verb=verb, status="done", took=0.0, result=result)
                query.reply(str(query.key_expr), wire.encode(outcome))

    async def ordered(self, verb: str) -> None:
        """Wait until it is told to."""
        while verb not in self.verbs:
            self._news.clear()
            await asyncio.wait_for(self._news.wait(), PATIENCE_S)

    async def _speak(self) -> None:
        while True:
            self.state.t = time.time()
            if not self.silent:
                self.session.put(keys.STATE.key("demo", self.name), wire.encode(self.state))
            await asyncio.sleep(EVERY)

    def close(self) -> None:
        self._task.cancel()
        self._queryable.undeclare()


TAKEN = wire.encode(wire.Outcome(verb="submit", status="done", took=0.0, result={"goal": GOAL}))
"""what a planner answers that takes a goal"""


class FakePlanner:
    """In charge by its word; ``answers``: how it takes a goal (None: not at all), ``entry``: how that stands."""

    def __init__(
        self, session: zenoh.Session, answers: bytes | Exception | None, entry: swarm.GoalState | None = None
    ) -> None:
        self.session, self._answers, self.entry = session, answers, entry
        self.asked: list[str] = []
        self.wanted: list[str] = []
        """whom it was asked to bring home"""
        self.silent = False
        self._unanswered: list[zenoh.Query] = []
        self._news = asyncio.Event()
        heard = on_loop(asyncio.get_running_loop(), self._on_query)
        self._queryable = session.declare_queryable(keys.SWARM.key("demo", "fake", verb="*"), heard)
        self._task = asyncio.create_task(self._speak())

    def _on_query(self, query: zenoh.Query) -> None:
        verb = str(query.key_expr).rpartition("/")[2]
        self.asked.append(verb)
        if verb == "submit" and query.payload is not None:
            self.wanted = wire.decode(query.payload.to_bytes(), swarm.Submit, verb).goal.vehicles
        self._news.set()
        if self._answers is None:
            self._unanswered.append(query)  # one that is dropped is over at once for who asks
            return
        with query:
            if isinstance(self._answers, ZmavError):
                query.reply_err(wire.error_body(self._answers))
            else:
                query.reply(str(query.key_expr), self._answers)

    async def told(self, verb: str) -> None:
        """Wait until it is asked for that."""
        while verb not in self.asked:
            self._news.clear()
            await asyncio.wait_for(self._news.wait(), PATIENCE_S)

    async def _speak(self) -> None:
        while True:
            if not self.silent:
                charge = swarm.Charge(t=time.time(), planner="fake", instance="1", term=1)
                self.session.put(keys.FLEET.key("demo", topic="charge"), wire.encode(charge))
                self.session.put(keys.FLEET.key("demo", topic="goal"), wire.encode(self._book()))
            await asyncio.sleep(EVERY)

    def _book(self) -> swarm.Book:
        goals = []
        if self.entry is not None and "submit" in self.asked:
            goal = swarm.Return(vehicles=self.wanted)
            goals = [swarm.GoalEntry(id=GOAL, goal=goal, state=self.entry, t=1.0, text="no way")]
        return swarm.Book(t=time.time(), planner="fake", instance="1", term=1, goals=goals)

    def close(self) -> None:
        self._task.cancel()
        self._queryable.undeclare()
        for query in self._unanswered:
            query.drop()
