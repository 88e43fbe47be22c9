"""What the viewer has chosen: order, filter, selection. Keys change it; nothing here knows a terminal."""

from __future__ import annotations

from dataclasses import dataclass

from ground.top.columns import COLUMNS, NAME, NAMES, Column
from ground.top.report import Report, VehicleReport, condition
from zmav.doctor.words import clean

FILTER_MOST = 40


@dataclass
class Ui:
    """``press(key)`` takes names like ``up``, ``enter`` and ``esc``, and characters as they are."""

    sort: str = NAME
    reverse: bool = False
    filter: str = ""
    typing: bool = False
    """keys go into the filter"""
    details: bool = False
    selected: tuple[str, str] | None = None
    """fleet and name of the vehicle; it stays chosen wherever it is sorted to"""
    over: bool = False
    page: int = 10
    """rows that the last screen showed"""

    def rows(self, report: Report) -> list[VehicleReport]:
        """The vehicles that match the filter, sorted; what is not known comes last either way."""
        words = self.filter.lower().split()
        found = [v for v in report.vehicles if all(word in _text(v) for word in words)]
        key = self.column.key
        known = [v for v in found if key(v) is not None]
        unknown = [v for v in found if key(v) is None]
        return sorted(known, key=key, reverse=self.reverse) + unknown

    @property
    def column(self) -> Column:
        """What is sorted by."""
        index = NAMES.index(self.sort) if self.sort in NAMES else 0
        return COLUMNS[index]

    def press(self, key: str, report: Report) -> None:
        if self.typing:
            self._type(key)
        elif key in ("q", "Q"):
            self.over = True
        elif key in ("up", "k", "down", "j", "pageup", "pagedown", "home", "end"):
            self._move(key, self.rows(report))
        elif key in ("left", "right", "<", ">"):
            step = 1 if key in ("right", ">") else -1
            self.sort = NAMES[(NAMES.index(self.sort) + step) % len(NAMES)]
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
        elif key == "r":
            self.reverse = not self.reverse

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
