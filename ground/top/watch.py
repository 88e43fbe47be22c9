"""Hears all that the monitor shows: states, events, links, agents, round trips and the network. It changes nothing."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

import mesh.graph
from ground.air import Listener
from ground.top.report import Report, describe
from mesh.graph import Graph
from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.doctor.facts import LINK_STALE, AgentReport, Facts, Happening, facts_of
from zmav.doctor.rules import PROOF
from zmav.doctor.ways import Link
from zmav.errors import BadInput, ZmavError
from zmav.subscription import document
from zmav.trust.member import Place
from zmav.vehicle import Vehicle
from zmav.waiting import together, within

TRIP_EVERY, NETWORK_EVERY = 2.0, 5.0
"""s between two rounds of queries to all vehicles, and between two looks at the mesh"""
ANSWER = 1.5
"""s for their answers"""
EVENTS, PAST = 10, 5
"""events kept of a vehicle, and those of the time before us that are asked for"""
VEHICLES, AGENTS = 1000, 1000
"""of which something is kept: invented names must not fill the memory"""
RECENT = 10.0
"""s over which drops are counted"""
AGENT_STALE = keys.AGENT_STATUS.stale_after or 5.0
AGENT_GONE = 60.0
"""s of silence after which an agent is no longer shown"""
FINISHED = ("ended", "done", "stopped")
"""last words of an agent that ends well"""
NOT_DROPPED = ("flown", "engaging", "held")


class LastStatus(NamedTuple):
    """An agent's status and when it came (monotonic seconds)."""

    status: wire.AgentStatus
    at: float


class VehicleHistory:
    """What is kept of one vehicle."""

    def __init__(self) -> None:
        self.events: collections.deque[wire.Event] = collections.deque(maxlen=EVENTS)
        self.link: wire.LinkQuality | None = None
        self.link_at = 0.0
        self.rtt: float | None = None
        self.rtt_at = 0.0
        self.drops: collections.deque[tuple[float, collections.Counter[str]]] = collections.deque(maxlen=64)
        """when, and all that was dropped until then"""

    def recent(self, now: float, state: wire.VehicleState | None) -> collections.Counter[str]:
        """What was dropped within the last seconds."""
        if state is None:
            return collections.Counter()
        total = _dropped(state)
        if not self.drops or now - self.drops[-1][0] > RECENT / 20:
            self.drops.append((now, total))
        while len(self.drops) > 1 and now - self.drops[1][0] >= RECENT:
            self.drops.popleft()
        return total - self.drops[0][1]


class Watch:
    """``run()`` hears until it is cancelled; :meth:`report` tells what is known, at any time."""

    def __init__(self, z: Client) -> None:
        self._z = z
        self._seen: dict[Place, VehicleHistory] = {}
        self._agents: dict[tuple[Place, str], LastStatus] = {}
        self._graph: Graph | None = None
        self._air = Listener(z)
        self._first = {"network": asyncio.Event(), "trips": asyncio.Event()}

    async def run(self) -> None:
        fleet = self._z.fleet_name
        with self._air:
            await together(
                self._hear(keys.EVENT.key(fleet, "*"), wire.Event, self._on_event, history=PAST),
                self._hear(keys.LINK.key(fleet, "*", link="autopilot"), wire.LinkQuality, self._on_link),
                self._hear(keys.AGENT_STATUS.key(fleet, "*", agent="*"), wire.AgentStatus, self._on_status),
                self._ask_all(),
                self._look(),
            )

    async def settle(self, most: float) -> None:
        """Wait until all vehicles and the network were asked once, and have had time to answer; ``most`` seconds."""

        async def asked() -> None:
            for event in self._first.values():
                await event.wait()

        begun = time.monotonic()
        await self._z.settle(most)
        with contextlib.suppress(asyncio.TimeoutError):
            await within(most - (time.monotonic() - begun), asked())

    # What comes.

    async def _hear(self, key: str, kind: type[Any], take: Callable[[Place, str, Any], None], history: int = 0) -> None:
        """``take`` gets whose it is, the key and the payload as a ``kind``."""
        async with self._z.subscribe(key, document(kind), history=history) as samples:
            async for key, value in samples:
                _, fleet, name, _ = key.split("/", 3)
                take((fleet, name), key, value)

    def _on_event(self, place: Place, _: str, event: wire.Event) -> None:
        if (seen := self._of(place)) is not None:
            seen.events.append(event)

    def _on_status(self, place: Place, key: str, status: wire.AgentStatus) -> None:
        who = (place, key.split("/")[4])
        if who in self._agents or len(self._agents) < AGENTS:
            self._agents[who] = LastStatus(status, time.monotonic())

    def _of(self, place: Place) -> VehicleHistory | None:
        """What is kept of a vehicle; None: there are too many."""
        if place not in self._seen and len(self._seen) >= VEHICLES:
            return None
        return self._seen.setdefault(place, VehicleHistory())

    def _on_link(self, place: Place, _: str, link: wire.LinkQuality) -> None:
        if (seen := self._of(place)) is not None:
            seen.link, seen.link_at = link, time.monotonic()

    # What is asked for.

    async def _ask_all(self) -> None:
        """One query to every vehicle's agent: how its link is, and how long the answer takes."""
        key = keys.LINK.key(self._z.fleet_name, "*", link="autopilot")
        while True:
            begun, took = time.perf_counter(), dict[str, float]()

            def came(answer: Answer, begun: float = begun, took: dict[str, float] = took) -> bool:
                took[answer.key] = time.perf_counter() - begun
                return False

            with contextlib.suppress(ZmavError, zenoh.ZError):  # no router at present: what is shown grows old
                for answer in await self._z.ask(key, timeout=ANSWER, channel=keys.LINK, enough=came):
                    if isinstance(answer, Answer) and (seen := self._on_answer(answer)) is not None:
                        seen.rtt, seen.rtt_at = took[answer.key], time.monotonic()
            self._first["trips"].set()
            await asyncio.sleep(TRIP_EVERY)

    def _on_answer(self, answer: Answer) -> VehicleHistory | None:
        with contextlib.suppress(BadInput):
            parts = keys.match(answer.key)[1]
            place = (parts["fleet"], parts["vehicle"])
            self._on_link(place, answer.key, wire.decode(answer.payload, wire.LinkQuality, answer.key))
            return self._of(place)
        return None

    async def _look(self) -> None:
        """At the mesh, where there is one."""
        while True:
            with contextlib.suppress(ZmavError, zenoh.ZError):
                self._graph = await mesh.graph.gather(self._z, tries=1)
            self._first["network"].set()
            await asyncio.sleep(NETWORK_EVERY)

    # What is known.

    def report(self) -> Report:
        """The fleet now."""
        for vehicle in self._z.fleet():
            self._of((vehicle.fleet, vehicle.name))
        now = time.monotonic()
        agents = self._agent_reports(now)
        found = {place: self._facts(place, seen, now, agents) for place, seen in sorted(self._seen.items())}
        known = {place: facts for place, facts in found.items() if facts is not None}
        systems = _systems(known)
        several = self._z.fleet_name == "*"
        vehicles = []
        for (fleet, name), facts in known.items():
            twins = systems.get((fleet, facts.state.sysid), []) if facts.state is not None else []
            others = tuple(other for other in twins if other != name)
            vehicles.append(describe(facts, fleet, others, self._graph, several))
        return Report(
            t=time.time(),
            fleet=self._z.fleet_name,
            router=self._linked(),
            vehicles=vehicles,
            agents=list(agents),
            aircraft=self._air.rows(),
        )

    @property
    def links(self) -> list[Link]:
        """Between routers, as their ends last measured them."""
        return list(self._graph.links) if self._graph is not None else []

    def _linked(self) -> bool:
        info = self._z.session.info
        return bool(info.routers_zid() or info.peers_zid())

    def _facts(self, place: Place, seen: VehicleHistory, now: float, agents: tuple[AgentReport, ...]) -> Facts | None:
        """None: no vehicle; something else, like a router, said a link's quality."""
        fleet, name = place
        heard = self._z.heard(name, fleet)
        token = self._z.present(name, fleet)
        if heard is None and not token and not seen.events:
            return None
        state, age = (heard.state, now - heard.at) if heard else (None, None)
        return facts_of(
            Vehicle(self._z, name, fleet),
            link=seen.link if seen.link is not None and now - seen.link_at < LINK_STALE else None,
            rtt=seen.rtt if now - seen.rtt_at < LINK_STALE else None,
            agents=tuple(agent for agent in agents if (agent.fleet, agent.host) == place),
            events=_happenings(seen, state, age),
            recent=seen.recent(now, state),
        )

    def _agent_reports(self, now: float) -> tuple[AgentReport, ...]:
        self._agents = {who: heard for who, heard in self._agents.items() if now - heard.at < _shown_for(heard.status)}
        return tuple(
            AgentReport(
                name=name,
                fleet=fleet,
                host=host,
                state=heard.status.state,
                text=heard.status.text,
                age=now - heard.at,
                stale=now - heard.at > AGENT_STALE,
            )
            for ((fleet, host), name), heard in sorted(self._agents.items())
        )


def _systems(known: dict[Place, Facts]) -> dict[tuple[str, int | None], list[str]]:
    """Names of the vehicles present by fleet and system id."""
    systems: dict[tuple[str, int | None], list[str]] = {}
    for (fleet, name), facts in known.items():
        if facts.presence == "ok" and facts.state is not None and facts.state.sysid is not None:
            systems.setdefault((fleet, facts.state.sysid), []).append(name)
    return systems


def _shown_for(status: wire.AgentStatus) -> float:
    """s of silence; who said that it ends is expected to say no more."""
    return AGENT_STALE if status.state.lower() in FINISHED else AGENT_GONE


def _happenings(seen: VehicleHistory, state: wire.VehicleState | None, age: float | None) -> tuple[Happening, ...]:
    """The newest first, with their ages by the vehicle's own clock where it is known."""
    now = state.t + (age or 0.0) if state else time.time()
    return tuple(
        Happening(age=max(now - event.t, 0.0), kind=event.kind, severity=event.severity, text=event.text)
        for event in reversed(seen.events)
    )


def _dropped(state: wire.VehicleState) -> collections.Counter[str]:
    """Setpoints and proofs refused so far."""
    counts = collections.Counter({why: n for why, n in state.setpoints.items() if why not in NOT_DROPPED})
    counts.update({PROOF + why: n for why, n in state.forbidden.items()})
    return counts
