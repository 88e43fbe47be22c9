"""A lab for a person: its hosts and its links as two tables."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table
from rich.text import Text

from mesh.lab.status import LabStatus, WayStatus
from mesh.units import byte_rate, rate


class Picture:
    """Draws a status; rates are since the one drawn before."""

    def __init__(self) -> None:
        self._before: LabStatus | None = None

    def of(self, status: LabStatus) -> Group:
        """Both tables, and a line about the relay."""
        before, self._before = self._before, status
        return Group(_hosts(status), Text(), _links(status, before), _relay(status, before))


def _hosts(status: LabStatus) -> Table:
    table = _table("host", "router", "addresses", "position", "vehicle")
    for host in status.hosts:
        router = "-" if host.running is None else "up" if host.running else "[red]DOWN[/]"
        place = "-" if host.position is None else f"{host.position[0]:.0f}, {host.position[1]:.0f}"
        addresses = " ".join(f"{name} {address}" for name, address in host.addresses.items())
        table.add_row(host.name, router, addresses, place, host.vehicle or "-")
    return table


def _table(*columns: str) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def _links(status: LabStatus, before: LabStatus | None) -> Table:
    table = _table("link", "state", "delay", "loss", "rate", "frames", "arrived", "lost", "full", "down", "now")
    old = {(w.sender, w.receiver, link.name): w for link in before.links for w in link.ways} if before else {}
    for link in status.links:
        for way in link.ways:
            past = old.get((way.sender, way.receiver, link.name))
            medium = f"{link.medium}:" if ":" in link.name else ""
            table.add_row(f"{medium}{way.sender}>{way.receiver}", *_way(way), _now(status, before, way, past))
    return table


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


def _now(status: LabStatus, before: LabStatus | None, way: WayStatus, past: WayStatus | None) -> str:
    if before is None or past is None or status.t <= before.t:
        return "-"
    return byte_rate((way.counters.arrived_bytes - past.counters.arrived_bytes) / (status.t - before.t))


def _relay(status: LabStatus, before: LabStatus | None) -> Text:
    text = f"{status.name}: fleet {status.fleet}, {status.under_way} frames under way"
    if before is not None and status.t > before.t:
        text += f", relay {100 * (status.relay_cpu_s - before.relay_cpu_s) / (status.t - before.t):.0f} % of a core"
    return Text(f"{text}; files in {status.directory}")
