"""One run of a study: so many vehicles behind so many routers, and what that costs where.

The ground's router stands at the first router, over one link that is counted. What a run measures is the fields of
:class:`Run`, and nothing in it is reckoned from anything else.
"""

from __future__ import annotations

import socket
import time
from typing import Any

import msgspec

from tests.bench.scale.fleet import LINK, Child, ask_all, until
from tests.bench.scale.meter import Meter
from tests.bench.scale.topology import Topology, links
from zmav.children import Children
from zmav.process import free_port

FLEET = "study"
NODE, STATION, GATEWAY = "tests.bench.scale.node", "tests.bench.scale.station", "tests.bench.scale.gatewaynode"


class Shape(msgspec.Struct, frozen=True, kw_only=True):
    """What is simulated."""

    vehicles: int
    routers: int
    """that have vehicles; the first relays for all others"""
    topology: Topology = "tree"
    groups: int = 0
    """0: one flat key space; else the routers are shared out among so many groups, each with a gateway"""
    seconds: float = 5.0
    """for each phase that counts something a second"""


class Run(msgspec.Struct, kw_only=True):
    """What one run measured. Times in s, sizes in bytes, CPU in shares of one core."""

    shape: Shape
    form: float
    """from the first vehicle's declaration until the last router knew every vehicle"""
    sync: float
    """from the ground's router's start until it knew every vehicle"""
    sync_bytes: int
    """over the ground's link meanwhile, both ways"""
    sync_cpu: float
    """CPU s that learning it took the ground's router"""
    idle_rate: float
    """B/s over the ground's link while vehicles speak and nobody reads"""
    rss: float
    """of the first router"""
    rss_ground: float
    """of the ground's router, which has no vehicle"""
    forming_cpu: float
    """CPU s of the first router until all was known"""
    trunk_rate: float
    """B/s over the ground's link with a ground station behind it"""
    states: float
    """a second, that the station took"""
    raw: float
    """frames of one vehicle a second"""
    offered: float
    """states a second that the vehicles put"""
    relay_cpu: float
    """of the ground's router meanwhile"""
    station_cpu: float
    known: int
    """vehicles of which the station knows the state"""
    ask: float | None
    """s for a query of every state; None where the hierarchy does not let it through"""
    ask_answers: int
    history: float
    """s for every token"""
    history_answers: int
    ping: float | None
    """s, median of an order to a vehicle and back"""
    ping_worst: float | None
    ping_lost: int
    late: int
    """beats that vehicles came too late with: above zero, the machine was too slow for this run"""


def endpoint(port: int) -> str:
    return f"udp/127.0.0.1:{port}{LINK}"


class Network:
    """Routers of one network and the ports they listen on."""

    def __init__(self, children: Children, name: str, topology: Topology, routers: int) -> None:
        self.ports = [free_port(socket.SOCK_DGRAM) for _ in range(routers)]
        self.local = f"tcp/127.0.0.1:{free_port()}"
        self.nodes: list[Child] = []
        for i, others in enumerate(links(topology, routers)):
            listen = [endpoint(self.ports[i]), *([self.local] if i == 0 else [])]
            how = {"fleet": FLEET, "listen": listen, "connect": [endpoint(self.ports[j]) for j in others]}
            self.nodes.append(Child(children, f"{name}{i}", NODE, how))

    def ready(self) -> None:
        for node in self.nodes:
            node.hear()

    def formed(self) -> bool:
        return all(answer["routers"] >= (len(self.nodes) > 1) for answer in ask_all(self.nodes, "usage"))

    def populate(self, numbers: range) -> None:
        """Share the vehicles out; each goes to one router. One router after the other: every router here takes its
        part of the same few cores, and a thousand vehicles that appear in the same second starve the links' leases.
        """
        for i, node in enumerate(self.nodes):
            node.ask("declare", numbers=list(numbers[i :: len(self.nodes)]))


def know(nodes: list[Child], vehicles: int) -> bool:
    """One after the other: side by side they would take the machine from those who form."""
    return all(node.ask("count")["tokens"] == vehicles for node in reversed(nodes))


def measure(
    children: Children, shape: Shape, nodes: list[Child], port: int, tokens: int, form: float, forming_cpu: float
) -> Run:
    """The ground's side, from the start of its router on, vehicles speaking. ``tokens``: of how many it learns."""
    with Meter(port) as meter:
        local = f"tcp/127.0.0.1:{free_port()}"
        start = time.monotonic()
        how = {"fleet": FLEET, "listen": [local], "connect": [endpoint(meter.port)]}
        ground = Child(children, "ground", NODE, how)
        ground.hear()
        cpu = ground.ask("usage")["cpu"]
        until(lambda: bool(ground.ask("usage")["routers"]), "the ground's router has its neighbour", 0.05)
        until(lambda: bool(ground.ask("count")["tokens"] >= tokens), "the ground knows every vehicle", 0.05)
        sync = time.monotonic() - start
        time.sleep(1.0)  # queryables and subscribers come beside the tokens
        sync_bytes, sync_cpu = meter.bytes, ground.ask("usage")["cpu"] - cpu
        idle_rate = _rate(meter, shape.seconds)
        said: dict[str, Any] = {"fleet": FLEET, "connect": [local], "vehicles": shape.vehicles, "groups": shape.groups}
        station = Child(children, "station", STATION, said)
        station.hear()
        until(lambda: bool(station.ask("known")["known"] >= shape.vehicles), "the station has heard everybody", 0.2)
        return _read(
            shape,
            nodes,
            ground,
            station,
            meter,
            form=form,
            sync=sync,
            sync_bytes=sync_bytes,
            sync_cpu=sync_cpu,
            idle_rate=idle_rate,
            forming_cpu=forming_cpu,
        )


def _rate(meter: Meter, seconds: float) -> float:
    bytes_before, before = meter.bytes, time.monotonic()
    time.sleep(seconds)
    return (meter.bytes - bytes_before) / (time.monotonic() - before)


def _read(shape: Shape, nodes: list[Child], ground: Child, station: Child, meter: Meter, **so_far: Any) -> Run:
    """With a station that reads: what flows for so many seconds, and then what is asked."""
    before, relay_before = station.ask("usage"), ground.ask("usage")
    trunk_rate = _rate(meter, shape.seconds)
    after, relay_after = station.ask("usage"), ground.ask("usage")
    took = after["t"] - before["t"]
    late = sum(answer["late"] for answer in ask_all(nodes, "usage"))
    asked, history, ping = station.ask("ask"), station.ask("tokens"), station.ask("ping")
    first = nodes[0].ask("usage")
    return Run(
        shape=shape,
        rss=first["rss"],
        rss_ground=relay_after["rss"],
        trunk_rate=trunk_rate,
        states=(after["states"] - before["states"]) / took,
        raw=(after["raw"] - before["raw"]) / took,
        offered=5.0 * shape.vehicles,
        relay_cpu=(relay_after["cpu"] - relay_before["cpu"]) / took,
        station_cpu=(after["cpu"] - before["cpu"]) / took,
        known=station.ask("known")["known"],
        ask=asked["seconds"] if asked["answers"] else None,
        ask_answers=asked["answers"],
        history=history["seconds"],
        history_answers=history["answers"],
        ping=ping["median"],
        ping_worst=ping["worst"],
        ping_lost=ping["lost"],
        late=late,
        **so_far,
    )
