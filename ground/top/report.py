"""What ``zmav top --json`` prints: one document for the whole fleet, and what the screen is drawn from.

SI units; degrees only where a name ends in ``_deg``; ages and times are seconds before ``t``, which is the UTC of this
computer. What is not known is null. Fields are only ever added.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec

from mesh.graph import Graph
from zmav import wire
from zmav.doctor.facts import AgentReport, Facts, Happening, Presence
from zmav.doctor.rules import Level, Reason, reasons
from zmav.doctor.ways import Link, Way
from zmav.wire import Vector


class LeaseReport(msgspec.Struct, kw_only=True, frozen=True):
    holder: str
    ends_in: float
    """s unless renewed"""
    priority: int


class LinkReport(msgspec.Struct, kw_only=True, frozen=True):
    """The link between companion and autopilot, as the companion sees it."""

    state: str
    url: str
    age: float | None
    """s since anything was heard on it"""
    rate: float
    """frames a second"""
    loss: float
    """0 to 1"""
    rtt: float | None
    """s, by TIMESYNC"""


class WeakHop(msgspec.Struct, kw_only=True, frozen=True):
    ends: tuple[str, str]
    state: str
    grade: str
    loss: float | None
    rtt: float | None


class NetworkReport(msgspec.Struct, kw_only=True, frozen=True):
    """The way from here to the vehicle."""

    rtt: float | None
    """s that a query takes to the vehicle's agent and back"""
    hops: int | None
    """links between routers; 0: its router is ours"""
    way: list[str]
    complete: bool
    weakest: WeakHop | None


class VehicleReport(msgspec.Struct, kw_only=True):
    """One vehicle; of one that is stale or gone, the last that was heard."""

    name: str
    fleet: str
    presence: Presence
    age: float | None
    """s since its state was heard; null: never"""
    level: Level
    reasons: list[Reason]
    """the worst first; empty: all is well"""
    sysid: int | None = None
    kind: str | None = None
    autopilot: str | None = None
    firmware: str | None = None
    mode: str | None = None
    status: str | None = None
    armed: bool | None = None
    ready: bool | None = None
    position: wire.GlobalPosition | None = None
    local: Vector | None = None
    """m, NED about the fleet's origin"""
    speed: float | None = None
    """m/s over the ground"""
    climb: float | None = None
    """m/s, up"""
    heading_deg: float | None = None
    """clockwise from north"""
    battery: float | None = None
    """0 to 1"""
    battery_left: float | None = None
    """s, by the autopilot's own estimate"""
    voltage: float | None = None
    gps: wire.Gps | None = None
    corrections: wire.CorrectionsInfo | None = None
    traffic: wire.TrafficInfo | None = None
    lease: LeaseReport | None = None
    mover: str = ""
    """who moves it; see :class:`zmav.wire.VehicleState`"""
    link: LinkReport | None = None
    network: NetworkReport
    agents: list[str] = []
    """names of the agents that speak under this vehicle"""
    events: list[Happening] = []
    """the newest first, ten at most"""


class Report(msgspec.Struct, kw_only=True):
    """The fleet at one moment."""

    t: float
    fleet: str
    """its name, or ``*``"""
    router: bool
    """this computer's session has a router at present; false: nothing can be heard, and everything grows old"""
    vehicles: list[VehicleReport]
    agents: list[AgentReport]
    """of every host, vehicles included"""
    aircraft: list[dict[str, Any]] = []
    """that are not of the fleet, the nearest first, as 'zmav traffic --json' has them"""

    def count(self) -> dict[str, int]:
        """How many vehicles are in each condition, by :func:`condition`."""
        counts: dict[str, int] = {}
        for vehicle in self.vehicles:
            word = condition(vehicle)
            counts[word] = counts.get(word, 0) + 1
        return counts


def condition(vehicle: VehicleReport) -> str:
    """In a word, which needs no colour: ok, note, WARN, BAD, STALE, GONE or SILENT."""
    if vehicle.presence != "ok":
        return vehicle.presence.upper()
    return vehicle.level.upper() if vehicle.level in ("warn", "bad") else vehicle.level


SAID = (
    *("sysid", "kind", "autopilot", "firmware", "mode", "status", "armed", "ready"),
    *("local", "position", "gps", "corrections", "traffic", "mover"),
)
"""what a report has of a vehicle's state as it is"""


def describe(facts: Facts, fleet: str, twins: tuple[str, ...], graph: Graph | None, several: bool) -> VehicleReport:
    """``several``: the graph is of many fleets, and names its hosts ``fleet/name``."""
    host = f"{fleet}/{facts.name}" if several else facts.name
    way = graph.ways.get(host) if graph else None
    facts = replace(facts, twins=twins, way=way)
    found = reasons(facts)
    report = VehicleReport(
        name=facts.name,
        fleet=fleet,
        presence=facts.presence,
        age=facts.age,
        reasons=found,
        level=found[0].level if found else "ok",
        network=_network(facts, way, host, graph),
        agents=[agent.name for agent in facts.agents],
        events=list(facts.events),
    )
    if facts.link is not None:
        link = facts.link
        report.link = LinkReport(
            state=link.state, url=link.url, age=link.age, rate=link.rx_rate, loss=link.loss, rtt=link.rtt
        )
    if facts.state is not None:
        _add_state(report, facts.state, facts.now)
    return report


def _add_state(report: VehicleReport, state: wire.VehicleState, now: float) -> None:
    """What the vehicle says of itself."""
    for name in SAID:
        setattr(report, name, getattr(state, name))
    if state.velocity is not None:
        north, east, down = state.velocity
        report.speed, report.climb = math.hypot(north, east), -down
    if state.attitude is not None:
        report.heading_deg = math.degrees(state.attitude.yaw % math.tau)  # degrees of a yaw that cannot be are infinite
    if state.battery is not None:
        report.battery, report.voltage = state.battery.remaining, state.battery.voltage
        report.battery_left = state.battery.time_left
    if state.lease is not None:
        lease = state.lease
        report.lease = LeaseReport(holder=lease.holder, ends_in=lease.expires - now, priority=lease.priority)


def _network(facts: Facts, way: Way | None, host: str, graph: Graph | None) -> NetworkReport:
    if way is None:
        here = graph is not None and graph.start == host
        return NetworkReport(rtt=facts.rtt, hops=0 if here else None, way=[], complete=here, weakest=None)
    return NetworkReport(
        rtt=facts.rtt, hops=len(way.links), way=list(way.hops), complete=way.complete, weakest=_weak(way.weakest)
    )


def _weak(link: Link | None) -> WeakHop | None:
    if link is None:
        return None
    return WeakHop(ends=(link.a, link.b), state=link.state, grade=link.grade, loss=link.worst_loss, rtt=link.rtt)
