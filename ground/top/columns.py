"""The table's columns: what each shows, how wide it is, and which give way on a narrow screen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from rich.cells import cell_len, set_cell_size

from ground.top.report import VehicleReport, condition
from zmav.doctor.words import clean, duration

ELLIPSIS = "~"
"""stands where a text was cut: every terminal has it"""


def cells(text: str) -> int:
    """Columns of a terminal that a clean text takes."""
    return len(text) if text.isascii() else cell_len(text)


def fit(text: str, width: int, *, right: bool = False) -> str:
    """Exactly ``width`` cells of a terminal: cleaned, cut with a mark, or filled with spaces."""
    text = clean(text)
    length = cells(text)
    if length > width:
        return set_cell_size(text, width - 1) + ELLIPSIS if width > 1 else ELLIPSIS[:width]
    space = " " * (width - length)
    return space + text if right else text + space


def percent(share: float | None) -> str:
    """Whole percents; what is lost at all is not shown as zero."""
    if share is None:
        return "-"
    return "<1%" if 0.0 < share < 0.005 else f"{share:.0%}"


def number(value: float | None, digits: int = 1, sign: str = "") -> str:
    if value is None:
        return "-"
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"  # no "-0.0"


def milliseconds(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    value = 1e3 * seconds
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


NAME, FLEET, MODE, RTCM, WHY, EVENT = "vehicle", "fleet", "mode", "rtcm", "why", "last event"
NAME_MOST, MODE_MOST = 16, 12
"""cells; longer names are cut"""
NARROW_WHY, WIDE_WHY = 20, 24
"""least cells for the reasons, below and from 120 columns"""


@dataclass(frozen=True)
class Column:
    """``rank``: the lower, the sooner it is shown."""

    name: str
    width: int
    rank: int
    text: Callable[[VehicleReport], str]
    right: bool = False


def _place(v: VehicleReport) -> str:
    p = v.position
    return "-" if p is None else f"{p.lat_deg:.5f} {p.lon_deg:.5f}"


def _gps(v: VehicleReport) -> str:
    if v.gps is None:
        return "-"
    fix = {"RTK_FIXED": "RTK", "RTK_FLOAT": "RTKf", "DGPS": "DGPS", "NO_GPS": "none", "NO_FIX": "none"}.get(
        v.gps.fix, v.gps.fix.removesuffix("_FIX")
    )
    return fix if v.gps.satellites is None else f"{fix} {v.gps.satellites}"


def _accuracy(v: VehicleReport) -> str:
    """As the receiver estimates it: centimetres where it is good to decimetres."""
    accuracy = v.gps.h_acc if v.gps else None
    return number(accuracy, 1 if accuracy is None or accuracy >= 0.1 else 2)


def _armed(v: VehicleReport) -> str:
    return "-" if v.armed is None else "ARMED" if v.armed else "no"


def _battery(v: VehicleReport) -> str:
    if v.battery is None and v.voltage is not None:
        return f"{v.voltage:.1f}V"
    return percent(v.battery)


def _lease(v: VehicleReport) -> str:
    """Its holder, and how long it lasts unless renewed."""
    return "" if v.lease is None else f"{fit(v.lease.holder, 8).rstrip()} {duration(v.lease.ends_in)}"


def _hop(v: VehicleReport) -> str:
    hop = v.network.weakest
    if hop is None:
        return "-"
    state = f" {hop.state}" if hop.state not in ("up", "unknown") else ""
    lost = f" {percent(hop.loss)} lost" if hop.loss else ""
    return f"{hop.ends[0]}-{hop.ends[1]}{state}{lost}"


def event(v: VehicleReport) -> str:
    """The last one."""
    return f"{duration(v.events[0].age)} ago: {v.events[0].text}" if v.events else ""


def why(v: VehicleReport) -> str:
    """What is not well."""
    return "; ".join(reason.text for reason in v.reasons)


def why_or_event(v: VehicleReport) -> str:
    """What is not well; where all is, the last event."""
    return why(v) or event(v)


def _link(v: VehicleReport, what: str) -> float | None:
    return getattr(v.link, what) if v.link else None


COLUMNS = (
    Column(NAME, 8, 0, lambda v: v.name),
    Column(FLEET, 8, 0, lambda v: v.fleet),
    Column("is", 6, 0, condition),
    Column("kind", 6, 14, lambda v: v.kind or "-"),
    Column("autopilot", 9, 17, lambda v: v.autopilot or "-"),
    Column("id", 3, 16, lambda v: str(v.sysid or "-"), right=True),
    Column(MODE, 8, 2, lambda v: v.mode or "-"),
    Column("armed", 5, 3, _armed),
    Column("latitude longitude", 19, 11, _place, right=True),
    Column("alt", 6, 5, lambda v: number(v.position.alt_rel if v.position else None), right=True),
    Column("m/s", 4, 6, lambda v: number(v.speed), right=True),
    Column("batt", 5, 4, _battery, right=True),
    Column("left", 5, 12, lambda v: duration(v.battery_left), right=True),
    Column("gps", 7, 8, _gps),
    Column("acc m", 5, 12, _accuracy, right=True),
    Column(RTCM, 5, 11, lambda v: duration(v.corrections.age) if v.corrections else "-", right=True),
    Column("age", 5, 1, lambda v: duration(v.age), right=True),
    Column("msg/s", 5, 9, lambda v: number(_link(v, "rate"), 0), right=True),
    Column("loss", 4, 9, lambda v: percent(_link(v, "loss")), right=True),
    Column("rtt ms", 6, 10, lambda v: milliseconds(v.network.rtt), right=True),
    Column("hops", 4, 12, lambda v: "-" if v.network.hops is None else str(v.network.hops), right=True),
    Column("weakest hop", 20, 18, _hop),
    Column("lease", 13, 7, _lease),
    Column("agents", 12, 15, lambda v: " ".join(v.agents)),
    Column(EVENT, 34, 13, event),
)
"""in the order in which they are shown, but for the reasons, which take what is left"""
REASONS = Column(WHY, NARROW_WHY, 0, why)


def choose(width: int, vehicles: list[VehicleReport]) -> list[Column]:
    """The columns that fit, the reasons last with what is left: never more than ``width`` cells, a space between two.
    The fleet is one of them where there are several, the age of corrections where any vehicle gets some.
    """
    longest = {
        NAME: min(max((len(v.name) for v in vehicles), default=0), NAME_MOST),
        MODE: min(max((len(v.mode or "") for v in vehicles), default=0), MODE_MOST),
    }
    one_fleet = len({v.fleet for v in vehicles}) < 2
    left_out = {FLEET} if one_fleet else set()
    if not any(v.corrections for v in vehicles):
        left_out.add(RTCM)
    every = [replace(c, width=max(longest.get(c.name, 0), c.width)) for c in COLUMNS if c.name not in left_out]
    left = width - (WIDE_WHY if width >= 120 else NARROW_WHY)
    shown: set[str] = set()
    for column in sorted(every, key=lambda c: c.rank):
        if column.rank and left < column.width + 1:
            break
        shown.add(column.name)
        left -= column.width + 1
    chosen = [column for column in every if column.name in shown]
    rest = width - sum(column.width + 1 for column in chosen)
    text = why if EVENT in shown else why_or_event
    return [*chosen, replace(REASONS, width=max(rest, 0), text=text)]
