"""What the planner says by itself: its book, what is flown, what it keeps clear of, and how it is."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Mapping

import msgspec
import numpy as np
import zenoh

from agents.planner.live.context import Context
from agents.planner.live.frames import ned
from agents.planner.live.leadership.election import BEAT, HEARTBEAT
from agents.planner.model.problem import Motion
from zmav import keys, wire
from zmav.errors import BadInput, BadKey
from zmav.waiting import within
from zmav.wire import swarm

AGENT = "planner"
SELDOM = 5.0
"""s between two times that plans and obstacles are said again where nothing has changed"""
LEAST = 0.3
"""s between two books, however much happens"""
SMALL = 6000
"""bytes of a book up to which links are not to repeat it: the next one comes within a second, and no later one waits"""
POINTS = 60
"""of a track at most"""


class StatusPublisher:
    """Lives on the event loop. A closed session hears nothing: no reason to stop."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.tasks: list[asyncio.Task[None]] = []
        self._plans: dict[str, swarm.PlanReport] = {}
        self._revision = -1
        self._key = keys.FLEET.key(context.settings.fleet, topic="goal")
        self._books: zenoh.Publisher | None = None
        self._beats: zenoh.Publisher | None = None

    def start(self) -> None:
        lane = keys.FLEET.publishing() | {"reliability": zenoh.Reliability.BEST_EFFORT}
        declare = self._context.z.session.declare_publisher
        self._books = declare(self._key, **lane)
        self._beats = declare(keys.FLEET.key(self._context.settings.fleet, topic="charge"), **lane)
        self.tasks += [asyncio.create_task(self._go_on()), asyncio.create_task(self._beat())]

    async def _beat(self) -> None:
        context, name = self._context, self._context.settings.name
        while True:
            if context.charge.in_charge and self._beats is not None:
                told = swarm.Charge(t=time.time(), planner=name, instance=context.instance, term=context.charge.term)
                self._send(keys.FLEET, str(self._beats.key_expr), told, self._beats)
            await asyncio.sleep(BEAT)

    async def _go_on(self) -> None:
        seldom = 0.0
        while True:
            now = time.monotonic()
            self.status()
            if self._context.charge.in_charge:
                self.book()
                if self._context.world.revision != self._revision or now - seldom > SELDOM:
                    self.obstacles()
                if now - seldom > SELDOM:
                    seldom = now
                    for report in self._plans.values():
                        self._put("plan", report)
            await asyncio.sleep(LEAST)
            with contextlib.suppress(asyncio.TimeoutError):
                await within(HEARTBEAT - LEAST, self._context.untold.wait())
            self._context.untold.clear()

    def book(self) -> None:
        data = wire.encode(self._context.book())
        self._send(keys.FLEET, self._key, data, self._books if len(data) <= SMALL else None)

    def last_book(self) -> None:
        """What a standby goes on from: nobody says it again."""
        self._send(keys.FLEET, self._key, wire.encode(self._context.book()))
        for publisher in (self._books, self._beats):
            if publisher is not None:
                publisher.undeclare()
        self._books = self._beats = None

    def obstacles(self) -> None:
        context = self._context
        self._revision = context.world.revision
        told = swarm.ObstacleMap(
            t=time.time(), planner=context.settings.name, instance=context.instance, obstacles=context.world.obstacles
        )
        self._put("obstacle", told)

    def plan(self, goal: str, start: float, motions: Mapping[str, Motion], clearance: float | None) -> None:
        """What is flown for a goal from now on; ``start`` is UTC."""
        tracks = {name: thin(motion) for name, motion in motions.items()}
        makespan = max((float(motion[-1, 0]) for motion in motions.values()), default=0.0)
        report = swarm.PlanReport(
            t=time.time(),
            planner=self._context.settings.name,
            goal=goal,
            start=start,
            makespan=makespan,
            clearance=clearance,
            tracks=tracks,
        )
        self._plans[goal] = report
        self._put("plan", report)

    def plan_over(self, goal: str) -> None:
        self._plans.pop(goal, None)

    def status(self) -> None:
        context = self._context
        last = context.events[-1].text if context.events else ""
        detail = {
            "term": context.charge.term,
            "of": context.charge.of,
            "goals": len(context.ledger.open),
            "events": [msgspec.to_builtins(event, enc_hook=str) for event in list(context.events)[-10:]],
        }
        status = wire.AgentStatus(t=time.time(), agent=AGENT, state=context.state, text=last, detail=detail)
        key = keys.AGENT_STATUS.key(context.settings.fleet, context.settings.name, agent=AGENT)
        self._send(keys.AGENT_STATUS, key, status)

    def _put(self, topic: str, payload: msgspec.Struct) -> None:
        self._send(keys.FLEET, keys.FLEET.key(self._context.settings.fleet, topic=topic), payload)

    def _send(
        self, channel: keys.Channel, key: str, payload: msgspec.Struct | bytes, publisher: zenoh.Publisher | None = None
    ) -> None:
        try:
            self._context.z.put(channel, key, payload, publisher=publisher)
        except BadInput as e:  # more than one message holds: who is in charge goes on saying the rest
            self._context.say_seldom("fault", "error", e.message)
        except (zenoh.ZError, BadKey):
            return


def thin(motion: Motion) -> list[tuple[float, float, float, float]]:
    """At most :data:`POINTS` of them, the first and the last among them; NED, centimetres."""
    step = max(1, -(-(len(motion) - 1) // (POINTS - 1)))
    kept = np.round(np.vstack((motion[:-1:step], motion[-1:])), 2) + 0.0
    return [(t, *ned((x, y, z))) for t, x, y, z in kept.tolist()]
