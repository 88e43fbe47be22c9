"""The screen as lines of styled text, each no wider than the terminal: drawn from a report and the viewer's choices."""

from __future__ import annotations

import textwrap
import time
from dataclasses import dataclass

from ground.top.columns import NAME, WHY, Column, cells, choose, fit
from ground.top.report import Report, VehicleReport, condition
from zmav.doctor.words import clean, duration

Line = list[tuple[str, str]]
"""pieces of text, each with its style"""
LEVEL_STYLES = {"bad": "bold red", "warn": "yellow", "note": "cyan"}
SEVERITY_STYLES = {"warning": "yellow", "info": "", "notice": "", "debug": "dim"}
LABEL = 11


def details(v: VehicleReport, report: Report, width: int) -> list[Line]:
    """Why it is not well, who moves it, its agents and last events, in full: the most important first."""
    lines: list[Line] = [_rule(v, width)]
    for i, reason in enumerate(v.reasons):
        lines.append(_line("why" if i == 0 else "", (f"{reason.level}: {reason.text}", LEVEL_STYLES[reason.level])))
    if v.mover not in ("", "nobody"):
        lines.append(_line("moved by", (v.mover, "")))
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


FILTER_MOST = 40


@dataclass
class Ui:
    """``press(key)`` takes names like ``up``, ``enter`` and ``esc``, and characters as they are."""

    filter: str = ""
    typing: bool = False
    """keys go into the filter"""
    details: bool = False
    selected: tuple[str, str] | None = None
    """fleet and name of the vehicle"""
    over: bool = False
    page: int = 10
    """rows that the last screen showed"""

    def rows(self, report: Report) -> list[VehicleReport]:
        """The vehicles that match the filter, by name."""
        words = self.filter.lower().split()
        found = [v for v in report.vehicles if all(word in _text(v) for word in words)]
        return sorted(found, key=lambda v: v.name)

    def press(self, key: str, report: Report) -> None:
        if self.typing:
            self._type(key)
        elif key in ("q", "Q"):
            self.over = True
        elif key in ("up", "k", "down", "j", "pageup", "pagedown", "home", "end"):
            self._move(key, self.rows(report))
        elif key == "esc":
            if self.details:
                self.details = False
            else:
                self.filter = ""
        elif key == "enter":
            if self.chosen(report) is None:
                self._move("home", self.rows(report))
            self.details = not self.details
        elif key == "/":
            self.typing = True

    def _type(self, key: str) -> None:
        if key == "enter":
            self.typing = False
        elif key == "esc":
            self.typing, self.filter = False, ""
        elif key == "backspace":
            self.filter = self.filter[:-1]
        elif len(key) == 1 and key.isprintable():
            self.filter = (self.filter + key)[:FILTER_MOST]

    def _move(self, key: str, rows: list[VehicleReport]) -> None:
        if not rows:
            return
        here = self.index(rows)
        steps = {"up": -1, "k": -1, "down": 1, "j": 1, "pageup": -self.page, "pagedown": self.page}
        if here is None and key in steps:
            to = 0 if steps[key] > 0 else len(rows) - 1
        else:
            to = {"home": 0, "end": len(rows) - 1}.get(key, (here or 0) + steps.get(key, 0))
        vehicle = rows[min(max(to, 0), len(rows) - 1)]
        self.selected = (vehicle.fleet, vehicle.name)

    def index(self, rows: list[VehicleReport]) -> int | None:
        """Where the selected vehicle is among them."""
        return next((i for i, v in enumerate(rows) if (v.fleet, v.name) == self.selected), None)

    def chosen(self, report: Report) -> VehicleReport | None:
        """The selected vehicle, where the filter shows it."""
        rows = self.rows(report)
        index = self.index(rows)
        return None if index is None else rows[index]


def _text(v: VehicleReport) -> str:
    """What the filter is looked for in."""
    parts = (v.name, condition(v), v.kind, v.autopilot, v.mode, "armed" if v.armed else "", v.lease and v.lease.holder)
    words = [*(part for part in parts if part), *v.agents, *(reason.text for reason in v.reasons)]
    return clean(" ".join(words)).lower()


STYLES = {"ok": "green", "note": "cyan", "WARN": "bold yellow"}
BAD = "bold red"
HELP = ("q quit", "/ filter", "enter details")
MOST_AIRCRAFT = 3
LEAST_TABLE = 4
"""rows of the table that details leave"""


def draw(ui: Ui, report: Report, width: int, height: int) -> list[Line]:
    """At most ``height`` lines."""
    rows = ui.rows(report)
    chosen = ui.chosen(report) if ui.details else None
    head = [_title(report, len(rows)), *_agents(report), *_air(report)]
    foot = _foot(ui, width)
    room = max(height - len(head) - 2, 1)
    below: list[Line] = []
    if chosen is not None:
        below = details(chosen, report, width)[: max(room - min(len(rows), LEAST_TABLE) - 1, 0)]
        room -= len(below)
    ui.page = max(room - 1, 1)
    lines = [*head, *table(rows, ui, width, room), *below]
    lines = lines[: height - 1]
    lines += [[] for _ in range(height - 1 - len(lines))]
    return [_cropped(line, width) for line in [*lines, foot]]


def table(rows: list[VehicleReport], ui: Ui, width: int, room: int | None = None) -> list[Line]:
    """A head and a line a vehicle; with ``room``, as many as have room around the selected one."""
    shown = choose(width, rows)
    index = ui.index(rows)
    above, end = 0, len(rows)
    more = ""
    if room is not None and len(rows) > room:
        room = max(room - 1, 1)  # a line says how many more there are
        above = min(max((index or 0) - room // 2, 0), len(rows) - room)
        end = above + room
        more = f"  {above} more above, {len(rows) - end} below (up, down, page keys)"
    lines = [_head(shown), *(_row(v, shown, selected=above + i == index) for i, v in enumerate(rows[above:end]))]
    if not rows:
        lines.append([("  no vehicle matches the filter" if ui.filter else "  no vehicle is heard", "yellow")])
    return [*lines, [(more, "dim")]] if more else lines


def _head(shown: list[Column]) -> Line:
    return [(" ".join(fit(column.name, column.width, right=column.right) for column in shown), "bold")]


def _row(v: VehicleReport, shown: list[Column], *, selected: bool) -> Line:
    base = "reverse" if selected else ""
    lost = v.presence != "ok"
    line: Line = []
    for column in shown:
        text = column.text(v)
        if selected and column.name == NAME:
            text = ">" + text
        style = _style(column, v, lost)
        line += [(fit(text, column.width, right=column.right), f"{base} {style}".strip()), (" ", base)]
    return line[:-1]


def _style(column: Column, v: VehicleReport, lost: bool) -> str:
    """A row that is not heard is dim, but for the word that says so, its age and the reason."""
    bad = lost or v.level == "bad"
    if column.name == "is":
        return BAD if bad else STYLES.get(condition(v), "")
    if column.name == WHY:
        return "red" if bad else "yellow" if v.level == "warn" else "" if v.reasons else "dim"
    if column.name == "age" and lost:
        return BAD
    if lost:
        return "dim"
    if column.name == "armed" and v.armed:
        return "bold green"
    return "bold" if column.name == NAME else ""


def _title(report: Report, shown: int) -> Line:
    counts = report.count()
    lost: Line = [] if report.router else [("  NO ROUTER: nothing can be heard", BAD)]
    total = len(report.vehicles)
    fleet = "all fleets" if report.fleet == "*" else report.fleet
    line: Line = [("zmav top ", "bold"), (time.strftime("%H:%M:%S", time.localtime(report.t)), "dim")]
    line += lost
    line.append((f"  {fleet}  {total} vehicle{'' if total == 1 else 's'}", ""))
    if shown != total:
        line.append((f", {shown} shown", ""))
    for i, word in enumerate(sorted(counts, key=_order)):
        line += [(": " if i == 0 else ", ", ""), (f"{counts[word]} {word}", STYLES.get(word, BAD))]
    return line


def _order(word: str) -> int:
    words = ("ok", "note", "WARN", "BAD", "SILENT", "STALE", "GONE")
    return words.index(word) if word in words else len(words)


def _agents(report: Report) -> list[Line]:
    """Agents that speak under no vehicle's name, like a planner on the ground; and any that failed or went silent."""
    vehicles = {(v.fleet, v.name) for v in report.vehicles}
    line: Line = []
    for agent in report.agents:
        if (agent.fleet, agent.host) in vehicles and not agent.stale:
            continue
        silent = f" SILENT for {duration(agent.age)}" if agent.stale else ""
        text = f": {agent.text}" if agent.text and not silent else ""
        words = f"{agent.name}@{agent.host} {agent.state}{text}{silent}"
        line += [("agents: " if not line else ", ", ""), (words, BAD if silent else "")]
    return [line] if line else []


def _air(report: Report) -> list[Line]:
    """Who else is in the air: the nearest."""
    lines: list[Line] = []
    for row in report.aircraft[:MOST_AIRCRAFT]:
        words = f"{row['callsign'] or row['icao']} {row['age']:.0f} s old"
        if row["distance"] is not None:
            height = "height unknown" if row["height"] is None else f"{row['height']:+d} m"
            where = f"{row['distance'] / 1e3:.1f} km from {row['vehicle']}, {height}"
            words += f", {where}, {row['nearest']} m in {row['time']} s"
        lines.append([("aircraft: " if not lines else " " * 10, ""), (words, "")])
    more = len(report.aircraft) - MOST_AIRCRAFT
    return [*lines, [(f"{' ' * 10}and {more} more: zmav traffic", "dim")]] if more > 0 else lines


def _foot(ui: Ui, width: int) -> Line:
    if ui.typing:
        return [("filter: ", "bold"), (ui.filter, ""), ("_", "blink"), ("   enter keep, esc clear", "dim")]
    line: Line = [(f"filter: {ui.filter} (esc clears)   ", "yellow")] if ui.filter else []
    return [*line, ("   ".join(HELP) if width >= 100 else "  ".join(HELP), "dim")]


def _cropped(line: Line, width: int) -> Line:
    """No wider than the terminal; every piece is cleaned here, anyone who wrote it."""
    found: Line = []
    for text, style in line:
        text = clean(text)
        size = cells(text)
        if size > width:
            found.append((fit(text, width), style))
            break
        found.append((text, style))
        width -= size
    return found
