"""One vehicle's report from what is known of it."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec

from ground.top.report import GpsReport, LeaseReport, LinkReport, NetworkReport, Position, VehicleReport, WeakHop
from mesh.topology import Graph, Link, Way
from zmav import wire
from zmav.doctor.facts import Facts
from zmav.doctor.rules import reasons


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
    report.sysid, report.kind, report.autopilot, report.firmware = (
        state.sysid,
        state.kind,
        state.autopilot,
        state.firmware,
    )
    report.mode, report.status, report.armed, report.ready = state.mode, state.status, state.armed, state.ready
    report.local = state.local
    if state.position is not None:
        report.position = Position(**msgspec.structs.asdict(state.position))
    if state.velocity is not None:
        north, east, down = state.velocity
        report.speed, report.climb = math.hypot(north, east), -down
    if state.attitude is not None:
        report.heading_deg = math.degrees(state.attitude.yaw) % 360.0
    if state.battery is not None:
        report.battery, report.voltage = state.battery.remaining, state.battery.voltage
    if state.gps is not None:
        report.gps = GpsReport(**msgspec.structs.asdict(state.gps))
    report.mover = state.mover
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
