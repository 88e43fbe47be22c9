"""What a lab tells of itself at one moment, and as a person sees it."""

from __future__ import annotations

import msgspec
from rich.console import Group
from rich.table import Table
from rich.text import Text

from mesh.lab.channel import Conditions, Counters
from mesh.lab.lab import Lab
from mesh.units import rate
from zmav.cli.common import table


class HostStatus(msgspec.Struct, frozen=True):
    """One host. ``running``: its router does; None: it has none."""

    name: str
    vehicle: str | None
    running: bool | None
    addresses: dict[str, str]
    """by interface"""


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
        hosts.append(HostStatus(name, lab.scenario.hosts[name].vehicle, running, addresses))
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
        hosts=hosts,
        links=links,
    )


def tables(status: LabStatus) -> Group:
    """For a person: hosts, links, and where the files are."""
    return Group(_hosts(status), Text(), _links(status), Text(f"fleet {status.fleet}; files in {status.directory}"))


def _hosts(status: LabStatus) -> Table:
    found = table(("host", "router", "addresses", "vehicle"))
    for host in status.hosts:
        router = "-" if host.running is None else "up" if host.running else "[red]DOWN[/]"
        addresses = " ".join(f"{name} {address}" for name, address in host.addresses.items())
        found.add_row(host.name, router, addresses, host.vehicle or "-")
    return found


def _links(status: LabStatus) -> Table:
    found = table(("link", "state", "delay", "loss", "rate", "frames", "arrived", "lost", "full", "down"))
    for link in status.links:
        medium = f"{link.medium}:" if ":" in link.name else ""
        for way in link.ways:
            found.add_row(f"{medium}{way.sender}>{way.receiver}", *_way(way))
    return found


def _way(way: WayStatus) -> tuple[str, ...]:
    c, n = way.conditions, way.counters
    jitter = f"±{1e3 * c.jitter:g}" if c.jitter else ""
    return (
        "up" if c.up else "[red]CUT[/]",
        f"{1e3 * c.delay:g}{jitter} ms",
        f"{100 * c.loss:.3g} %" + (f" in bursts of {c.burst:g}" if c.burst > 1 and c.loss else ""),
        rate(c.rate),
        str(n.frames),
        str(n.arrived),
        str(n.lost),
        str(n.queue_full),
        str(n.down),
    )
