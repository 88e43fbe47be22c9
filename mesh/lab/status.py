"""What a lab tells of itself at one moment."""

from __future__ import annotations

import time

import msgspec

from mesh.lab.channel import Conditions, Counters
from mesh.lab.lab import Lab
from mesh.lab.scenario import Place


class HostStatus(msgspec.Struct, frozen=True):
    """One host. ``running``: its router does; None: it has none."""

    name: str
    vehicle: str | None
    running: bool | None
    addresses: dict[str, str]
    """by interface"""
    position: Place | None
    """m north and east"""


class WayStatus(msgspec.Struct, frozen=True):
    """One direction of a link."""

    sender: str
    receiver: str
    conditions: Conditions
    counters: Counters


class LinkStatus(msgspec.Struct, frozen=True):
    """Two that hear each other."""

    name: str
    medium: str
    ways: tuple[WayStatus, WayStatus]


class LabStatus(msgspec.Struct, frozen=True):
    """The whole lab."""

    name: str
    fleet: str
    directory: str
    t: float
    """s, of a clock that only goes forward"""
    relay_cpu_s: float
    """that moving frames has taken so far"""
    under_way: int
    """frames"""
    hosts: list[HostStatus]
    links: list[LinkStatus]


def status_of(lab: Lab) -> LabStatus:
    """Ask the relay, and put names to its numbers."""
    network = lab.network
    counted = network.counted()
    hosts = []
    for name in lab.hosts:
        program = lab.programs.get(name)
        addresses = {each.name: each.address for each in network.wiring.interfaces if each.host == name}
        running = None if program is None else program.running
        position = lab.mobility.positions.get(name)
        hosts.append(HostStatus(name, lab.scenario.hosts[name].vehicle, running, addresses, position))
    links = []
    for edge in network.wiring.edges:
        there, back = (
            WayStatus(sender, receiver, network.state(number), counted.channels[number])
            for sender, receiver, number in ((edge.a, edge.b, edge.ab), (edge.b, edge.a, edge.ba))
        )
        links.append(LinkStatus(edge.name, edge.medium, (there, back)))
    return LabStatus(
        name=lab.scenario.name,
        fleet=lab.fleet,
        directory=str(lab.directory),
        t=time.monotonic(),
        relay_cpu_s=counted.cpu_s,
        under_way=counted.under_way,
        hosts=hosts,
        links=links,
    )
