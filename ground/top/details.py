"""One vehicle in full: why it is not well, its links, agents and lease, its last events."""

from __future__ import annotations

import textwrap

from ground.top.columns import milliseconds, number, percent
from ground.top.report import Report, VehicleReport
from zmav.doctor.words import clean, duration

Line = list[tuple[str, str]]
"""pieces of text, each with its style"""
LEVEL_STYLES = {"bad": "bold red", "warn": "yellow", "note": "cyan"}
SEVERITY_STYLES = {"warning": "yellow", "info": "", "notice": "", "debug": "dim"}
LABEL = 11


def details(v: VehicleReport, report: Report, width: int) -> list[Line]:
    """As many lines as it takes; the most important first."""
    lines: list[Line] = [_rule(v, width)]
    for i, reason in enumerate(v.reasons):
        lines.append(_line("why" if i == 0 else "", (f"{reason.level}: {reason.text}", LEVEL_STYLES[reason.level])))
    said = {"is": _is(v), "place": _place(v), "power, GPS": _health(v), "link": _link(v), "network": _network(v)}
    if (lease := v.lease) is not None:
        said["lease"] = f"{lease.holder} (priority {lease.priority}), ends in {duration(lease.ends_in)} unless renewed"
    if v.mover not in ("", "nobody"):
        said["moved by"] = v.mover
    lines += [_line(label, (words, "")) for label, words in said.items()]
    for agent in report.agents:
        if (agent.fleet, agent.host) == (v.fleet, v.name):
            text = f": {agent.text}" if agent.text else ""
            state = "SILENT, last " + agent.state if agent.stale else agent.state
            style = "bold red" if agent.stale else ""
            lines.append(_line("agent", (f"{agent.name} {state}{text} ({duration(agent.age)} ago)", style)))
    for i, event in enumerate(v.events):
        style = SEVERITY_STYLES.get(event.severity, "bold red")
        words = f"{duration(event.age):>5} ago  {event.severity}: {event.text}"
        lines.append(_line("events" if i == 0 else "", (words, style)))
    return [part for line in lines for part in _wrapped(line, width)]


def _wrapped(line: Line, width: int) -> list[Line]:
    """A label and its text on as many lines as they take."""
    if len(line) < 2:
        return [line]
    (label, bold), (words, style) = line
    parts = textwrap.wrap(clean(words), max(width - LABEL, 20)) or [""]
    return [[(label if i == 0 else " " * LABEL, bold), (part, style)] for i, part in enumerate(parts)]


def _line(label: str, piece: tuple[str, str]) -> Line:
    return [(f"{label:<{LABEL}}", "bold"), piece]


def _rule(v: VehicleReport, width: int) -> Line:
    title = f"-- {v.name} "
    return [(title + "-" * max(width - len(title), 0), "bold")]


def _is(v: VehicleReport) -> str:
    known = [
        v.kind or "unknown kind",
        f"{v.autopilot or 'no autopilot'} {v.firmware or ''}".strip(),
        f"system {v.sysid or '-'}",
        f"mode {v.mode or '-'}",
        "armed" if v.armed else "disarmed" if v.armed is not None else "arming unknown",
        v.status or "",
        f"state {duration(v.age)} old",
    ]
    return ", ".join(word for word in known if word)


def _place(v: VehicleReport) -> str:
    p = v.position
    words = (
        []
        if p is None
        else [f"{p.lat_deg:.7f} {p.lon_deg:.7f}", f"{p.alt_rel:.1f} m above home, {p.alt_amsl:.1f} m AMSL"]
    )
    if v.local is not None:
        words.append("NED {:.1f} {:.1f} {:.1f}".format(*v.local))
    if v.speed is not None:
        words.append(f"{v.speed:.1f} m/s, climb {number(v.climb, 1, '+')} m/s")
    if v.heading_deg is not None:
        words.append(f"heading {round(v.heading_deg) % 360}")
    return ", ".join(words) or "no position"


def _health(v: VehicleReport) -> str:
    words = [percent(v.battery)]
    if v.voltage is not None:
        words.append(f"{v.voltage:.2f} V")
    if v.gps is not None:
        words.append(f"{v.gps.fix}, {v.gps.satellites if v.gps.satellites is not None else '-'} satellites")
        words.append(f"HDOP {number(v.gps.hdop)}")
    return ", ".join(words)


def _link(v: VehicleReport) -> str:
    link = v.link
    if link is None:
        return "nothing heard of it"
    return (
        f"{link.url} {link.state}, {link.rate:.0f} msg/s, {percent(link.loss)} lost, "
        f"round trip {milliseconds(link.rtt)} ms, heard {duration(link.age)} ago"
    )


def _network(v: VehicleReport) -> str:
    n = v.network
    words = [f"answers in {milliseconds(n.rtt)} ms" if n.rtt is not None else "no answer to queries"]
    if n.hops is not None:
        words.append("its router is ours" if n.hops == 0 else " > ".join(n.way) + ("" if n.complete else " > ?"))
    if n.weakest is not None:
        hop = n.weakest
        words.append(
            f"weakest hop {hop.ends[0]} - {hop.ends[1]}: {hop.grade}, {hop.state}, "
            f"{percent(hop.loss)} lost, {milliseconds(hop.rtt)} ms"
        )
    return ", ".join(words)
