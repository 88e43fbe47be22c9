"""What ``zmav doctor`` gathers of the key space before anything is judged. Every wait has an end."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

import msgspec
import zenoh

from zmav import keys, wire
from zmav.autopilots.safety import Safety
from zmav.client import Answer, Client
from zmav.config import FleetConfig
from zmav.doctor.air import RemoteId, remote_id_of
from zmav.doctor.credentials import Trust, look_at_trust
from zmav.doctor.facts import AgentReport
from zmav.doctor.failsafes import Value, read_safety
from zmav.errors import BadInput, ZmavError
from zmav.tokens import find_tokens
from zmav.trust.credentials import Credentials
from zmav.vehicle.vehicle import Vehicle
from zmav.waiting import alongside, together, within

PINGS = 5
PART_S = 15.0
"""s for each part of the examination; they go on side by side"""
MOST = 250
"""vehicles that are asked, tokens and links that are kept: anyone who fills the key space with names gets no further"""

T = TypeVar("T")


class ClockOffset(msgspec.Struct, frozen=True):
    """A vehicle's clock less ours in seconds, and by how much that may be wrong: half the round trip."""

    offset: float
    within: float


class RouterSession(msgspec.Struct, frozen=True):
    """What is linked to a router: another router, or a client."""

    peer: str
    whatami: str


class RouterReport(msgspec.Struct, frozen=True):
    """What a router of Zenoh says of itself in its admin space, as far as it is used here."""

    version: str = ""
    locators: list[str] = []
    sessions: list[RouterSession] = []


class Survey(msgspec.Struct, frozen=True):
    """What was seen of the key space; the dicts are by vehicle (``fleet/name``), and lack those that said nothing."""

    vehicles: list[Vehicle] = []
    routers: dict[str, RouterReport] = {}
    """by Zenoh id"""
    links: dict[str, list[wire.LinkQuality]] = {}
    """oldest first"""
    clocks: dict[str, ClockOffset | ZmavError] = {}
    safety: dict[str, dict[Safety, Value | None] | ZmavError] = {}
    terrain: dict[str, wire.TerrainReport | None] = {}
    """None where it did not say"""
    remote_ids: dict[str, RemoteId] = {}
    gimbals: dict[str, dict[str, Any] | None] = {}
    """where each looks and who controls it; None where there is none"""
    trust: Trust | None = None
    neighbours: dict[tuple[str, str], wire.NeighbourQuality] = {}
    """by (host, neighbour), the newest"""
    hosts: dict[str, wire.HostReport | dict[str, str] | ZmavError] = {}
    """how each host's computer is; of a report that is not known here, the versions it names"""
    agents: list[AgentReport] = []
    tokens: list[dict[str, str]] = []
    """who is present, by the parts of their liveliness tokens"""
    unfinished: list[str] = []
    """what was not done in time"""
    file: FleetConfig | None = None
    name: str | None = None
    """which host of the file this is"""


async def look(
    z: Client, seconds: float, own: Credentials | None = None, file: FleetConfig | None = None, name: str | None = None
) -> Survey:
    """Listen for ``seconds``, then ask; what is shown to prove who one is, is judged by our ``own`` credentials."""
    listener = StatusListener(z)
    async with alongside(listener.listen()):
        await asyncio.sleep(seconds)
        vehicles = (await z.settle())[:MOST]
        present = [v for v in vehicles if v.present and keys.NAME.match(v.name)]
        parts: dict[str, Coroutine[Any, Any, Any]] = {
            "links": listener.ask(),
            "routers": find_routers(z),
            "tokens": find_present(z),
            "hosts": find_hosts(z),
            "clocks": _of_each(present, _clock_of),
            "safety": _of_each(present, read_safety),
            "terrain": _of_each(present, lambda vehicle: _or_none(vehicle.terrain.report())),
            "remote_ids": _of_each(present, remote_id_of),
            "gimbals": _of_each(present, lambda vehicle: _or_none(vehicle.gimbal("status"))),
            "trust": look_at_trust(z, own, [v.name for v in present]),
        }
        found: dict[str, Any] = {}
        late: list[str] = []

        async def finish(part: str, work: Coroutine[Any, Any, Any]) -> None:
            try:
                found[part] = await within(PART_S, work)
            except asyncio.TimeoutError:
                late.append(f"{part}: not done within {PART_S:.0f} s")
            except ZmavError as e:
                late.append(f"{part}: {e.message}")

        await asyncio.gather(*(finish(part, work) for part, work in parts.items()))
        found |= {"links": listener.autopilots, "neighbours": listener.neighbours, "agents": listener.agents()}
        return Survey(vehicles=vehicles, unfinished=late, file=file, name=name, **found)


async def _of_each(vehicles: list[Vehicle], ask: Callable[[Vehicle], Awaitable[T]]) -> dict[str, T]:
    return dict(zip(map(label, vehicles), await asyncio.gather(*map(ask, vehicles)), strict=True))


def label(vehicle: Vehicle) -> str:
    """``fleet/name``."""
    return f"{vehicle.fleet}/{vehicle.name}"


class StatusListener:
    """Hears links' qualities and agents' statuses."""

    def __init__(self, z: Client) -> None:
        self._z = z
        self.autopilots: dict[str, list[wire.LinkQuality]] = defaultdict(list)
        self.neighbours: dict[tuple[str, str], wire.NeighbourQuality] = {}
        self._agents: dict[tuple[str, str, str], tuple[wire.AgentStatus, float]] = {}

    async def listen(self) -> None:
        """Until cancelled."""
        fleet = self._z.fleet_name
        links, statuses = keys.LINK.key(fleet, "*", link="*"), keys.AGENT_STATUS.key(fleet, "*", agent="*")
        await together(self._hear(links, self._on_link), self._hear(statuses, self._on_status))

    async def _hear(self, key: str, take: Any) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            take(str(sample.key_expr), sample.payload.to_bytes())

        async with self._z.subscribe(key, on_sample) as samples:
            async for _ in samples:
                pass

    async def ask(self) -> None:
        """What is told of links once a second, told now."""
        key = keys.LINK.key(self._z.fleet_name, "*", link="*")
        for answer in await self._z.ask(key, timeout=1.0, channel=keys.LINK):
            if isinstance(answer, Answer):
                with contextlib.suppress(BadInput):
                    quality = wire.decode_link(answer.payload)
                    if isinstance(quality, wire.NeighbourQuality):
                        self._on_link(answer.key, answer.payload)

    def _on_link(self, key: str, payload: bytes) -> None:
        parts, quality = keys.match(key)[1], wire.decode_link(payload)
        host = f"{parts['fleet']}/{parts['vehicle']}"
        if isinstance(quality, wire.LinkQuality):
            if host in self.autopilots or len(self.autopilots) < MOST:
                heard = self.autopilots[host]
                if heard and quality.rx_frames < heard[-1].rx_frames:
                    heard.clear()  # its program has started again, and counts anew
                heard.append(quality)
        elif quality.name == keys.check_name(parts["link"]) and len(self.neighbours) < MOST * MOST:
            self.neighbours[host, f"{parts['fleet']}/{quality.name}"] = quality

    def _on_status(self, key: str, payload: bytes) -> None:
        parts = keys.match(key)[1]
        who = parts["fleet"], parts["vehicle"], keys.check_name(parts["agent"])
        if who in self._agents or len(self._agents) < MOST:
            self._agents[who] = wire.decode(payload, wire.AgentStatus, "status"), time.monotonic()

    def agents(self) -> list[AgentReport]:
        now = time.monotonic()
        return [
            AgentReport.of(fleet, host, status, now - at)
            for (fleet, host, _), (status, at) in sorted(self._agents.items())
        ]


async def find_routers(z: Client) -> dict[str, RouterReport]:
    """Every router that answers; what is not to be read as that is left out."""
    found = {}
    for answer in await z.ask("@/*/router", timeout=2.0):
        if isinstance(answer, Answer):
            with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                found[answer.key.split("/")[1]] = msgspec.json.decode(answer.payload, type=RouterReport)
    return found


async def find_present(z: Client) -> list[dict[str, str]]:
    """Who is present, of every role."""
    key = keys.ALIVE.key(z.fleet_name, "*", role="*", sys="*", autopilot="*", uid="*", instance="*")
    tokens = []
    for each in sorted(set(await asyncio.to_thread(find_tokens, z.session, key, 1.0)))[: 4 * MOST]:
        with contextlib.suppress(BadInput):
            tokens.append(keys.match(each)[1])
    return tokens


async def find_hosts(z: Client) -> dict[str, wire.HostReport | dict[str, str] | ZmavError]:
    """How every host's computer is, by its own words."""
    found: dict[str, wire.HostReport | dict[str, str] | ZmavError] = {}
    for answer in await z.ask(keys.HOST.key(z.fleet_name, "*"), channel=keys.HOST):
        if isinstance(answer, Answer) and len(found) < MOST:
            with contextlib.suppress(BadInput):
                parts = keys.match(answer.key)[1]
                found[f"{parts['fleet']}/{parts['vehicle']}"] = _report(answer.payload)
    return found


class _Versions(msgspec.Struct):
    """What is read of a report that another zmav made otherwise."""

    versions: dict[str, str]


def _report(payload: bytes) -> wire.HostReport | dict[str, str] | ZmavError:
    try:
        return wire.decode(payload, wire.HostReport, "host")
    except BadInput as e:
        try:
            return msgspec.json.decode(payload, type=_Versions).versions
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return e


async def _or_none(asked: Coroutine[Any, Any, T]) -> T | None:
    try:
        return await asked
    except ZmavError:
        return None


async def _clock_of(vehicle: Vehicle) -> ClockOffset | ZmavError:
    """By the quickest of a few round trips, taken to be as long there as back."""
    clocks = []
    try:
        for _ in range(PINGS):
            sent = time.time()
            there = (await vehicle.order("ping", wire.Order())).get("t")
            back = time.time()
            if not isinstance(there, (int, float)) or not math.isfinite(there):
                return ZmavError(f"its ping brings no time: {there!r}")
            clocks.append(ClockOffset(there - (sent + back) / 2, (back - sent) / 2))
    except ZmavError as e:
        return e
    return min(clocks, key=lambda clock: clock.within)
