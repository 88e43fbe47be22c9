"""What was measured, as a table beside the paper's figures, as JSON and as pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
from rich.table import Table

from tests.bench.controllers import links as linked
from tests.bench.controllers import trip as tripped
from tests.bench.controllers.clock import Clock
from tests.bench.controllers.cpu import Cpu
from tests.bench.controllers.flight import lemniscate
from tests.bench.controllers.handback import Back
from tests.bench.controllers.links import Links
from tests.bench.controllers.spread import Spread
from tests.bench.controllers.tracking import PX4, Tracking
from tests.bench.controllers.trip import Trip
from zmav import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = tuple[str, str, str]
"""what, its figures, and the paper's figure or the aim"""
MARKED = 50
"""points of a curve, up to which each is marked"""


class Report(msgspec.Struct):
    """None: not measured. ``failed``: by measurement, why it has no figures."""

    t: float
    processors: int
    loads: dict[str, tuple[float, float]] = {}
    """by measurement: runnable tasks over a minute, before and after it"""
    links: Links | None = None
    trip: Trip | None = None
    handback: dict[str, Back] | None = None
    clock: Clock | None = None
    cpu: Cpu | None = None
    tracking: Tracking | None = None
    failed: dict[str, str] = {}


def table(report: Report) -> Table:
    """All figures."""
    found = Table("", "measured", "paper, or aim", box=None, pad_edge=False, header_style="bold")
    for name, rows in sections(report):
        before, after = report.loads.get(name, (0.0, 0.0))
        about = f"load {before:.1f} to {after:.1f} on {report.processors} processors"
        found.add_row(f"[bold]{name}[/bold]", f"[dim]{about}[/dim]", "")
        for row in rows:
            found.add_row(*row)
    for name, why in report.failed.items():
        found.add_row(f"[bold]{name}[/bold]", f"failed: {why}", "")
    return found


def sections(report: Report) -> Iterator[tuple[str, list[Row]]]:
    """The rows of each measurement that was made."""
    if report.links:
        yield "links", _links(report.links)
    if report.trip:
        rows = _trip(report.trip) + (_backs(report.handback) if report.handback else [])
        yield "trip", rows
    if report.clock:
        yield "clock", _clock(report.clock)
    if report.cpu:
        yield "cpu", _cpu(report.cpu)
    if report.tracking:
        yield "tracking", _tracking(report.tracking)


def _links(found: Links) -> list[Row]:
    rows = [(f"over {found.seconds:.0f} s", f"{found.mbps:.2f} Mb/s", linked.PAPER)]
    lost = f"{found.frames_lost} of {found.frames}"
    rows.append(("frames of the autopilot", f"lost {lost}", "0 of 1785"))
    for name, each in found.streams.items():
        text = f"{each.hz:.1f} Hz, {each.kbps:.0f} kb/s, jitter {each.jitter_ms:.2f} ms, p99 {each.late_ms:.2f} ms"
        text += "" if each.lost is None else f", lost {each.lost} of {each.count}"
        rows.append((name, text, "jitter 0.49 to 1.37 ms"))
    rows.append(("", "jitter: RFC 3550; p99: of how far an interval is from the nominal one", ""))
    return rows


def _trip(found: Trip) -> list[Row]:
    return [
        ("stick to output, back at the link", _us(found.back), f"mean {tripped.PAPER_MEAN:.0f} µs; median < 1000 µs"),
        ("stick to output, in the key space", _us(found.output), ""),
        ("stick to the key space", _us(found.radio), ""),
        ("stick to the controller", _us(found.controller), ""),
        ("supervisor and controller", _us(found.inside), ""),
        ("stick at any moment, back at the link", _us(found.anytime), ""),
        ("waiting for the next cycle adds", f"{found.waiting:.0f} µs on the mean", f"half of {found.period:.0f} µs"),
    ]


def _us(spread: Spread) -> str:
    return f"median {spread.median:.0f}, mean {spread.mean:.0f}, p99 {spread.p99:.0f} µs of {spread.count}"


def _backs(found: dict[str, Back]) -> list[Row]:
    rows = []
    for kind, each in found.items():
        told, last = each.told, each.last
        text = f"median {told.median / 1e3:.1f}, worst {told.most / 1e3:.1f} ms of {told.count}"
        text += f"; last output {last.median / 1e3:.1f}, at most {last.most / 1e3:.1f} ms"
        rows.append((f"handed back: {kind}", text, "one cycle and the link" if "switch" in kind else "100 ms"))
    return rows


def _clock(found: Clock) -> list[Row]:
    rows = []
    for name, off in _ppm(found).items():
        text = (
            f"median {np.median(off):+.0f} ppm, {min(off):+.0f} to {max(off):+.0f} of {len(off)} × {found.seconds:g} s"
        )
        rows.append((f"{name} / autopilot's clock", text, "1"))
    return [*rows, ("runs left out", str(found.broken), "")] if found.broken else rows


def _ppm(found: Clock) -> dict[str, list[float]]:
    """How much faster each clock goes than the autopilot's, run by run."""
    named = {"sum of the controller's dt": found.integrated, "State.t": found.stated, "this machine": found.host}
    return {name: [1e6 * (each - 1.0) for each in ratios] for name, ratios in named.items()}


def _cpu(found: Cpu) -> list[Row]:
    rows: list[Row] = [(name, f"{value:.1f} % of a processor", "") for name, value in found.percent.items()]
    missed = f"{found.late} of {found.cycles} ({100.0 * found.missed:.3f} %) in {found.seconds:.0f} s"
    return [*rows, ("missed deadlines", missed, "under 0.1 %")]


def _tracking(found: Tracking) -> list[Row]:
    rows: list[Row] = [("wind, seed", f"{found.wind}, {found.seed}", "")]
    own = found.lemniscate.get(PX4)
    for who, each in found.lemniscate.items():
        text = f"RMS {each.rms:.3f} m, peak {each.peak:.3f} m, attitude RMS {each.attitude_deg:.1f}°"
        beside = f"{each.rms / own.rms:.2f} of {PX4}'s" if own and who != PX4 else ""
        rows.append((f"lemniscate: {who}", text, beside))
    for who, told in found.ev3.items():
        rows.append((f"EV3: {who}", str(told["text"]), "peaks at corners only"))
    rows += [("flown again", why, "") for why in found.broken]
    return rows


# Pictures.


class Panel(NamedTuple):
    """Curves in one pair of axes: what each is called, and its x and y (N,). ``options``: of the axes."""

    curves: list[tuple[str, Any, Any]]
    options: dict[str, Any]


def save(report: Report, folder: Path) -> list[Path]:
    """bench.json and a picture of each measurement that is more than a few numbers; gives their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    saved = [folder / "bench.json"]
    saved[0].write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1))
    for name, panels in _pictures(report).items():
        if panels:
            saved.append(folder / f"{name}.png")
            figures.save(_drawn(panels), saved[-1])
    return saved


def _drawn(panels: list[Panel]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0 * len(panels), 4.2), dpi=110, layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for name, x, y in panel.curves:
            axes.plot(x, y, label=name, linewidth=0.9, marker="." if len(x) <= MARKED else "")
        axes.set(**panel.options)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def _pictures(report: Report) -> dict[str, list[Panel]]:
    """By measurement; none of what was not made."""
    return {
        "links": [_jitter(report.links)] if report.links else [],
        "trip": ([_delays(report.trip)] if report.trip else [])
        + ([_hand_backs(report.handback)] if report.handback else []),
        "clock": [_drift(report.clock)] if report.clock else [],
        "tracking": [_way(report.tracking), _errors(report.tracking)]
        if report.tracking and report.tracking.lemniscate
        else [],
    }


def _jitter(found: Links) -> Panel:
    curves = []
    for name, each in found.streams.items():
        nominal = linked.NOMINAL.get(name, linked.SIGNALS_HZ if name == linked.SIGNALS else 250.0)
        off = np.sort(np.abs(np.array(each.gaps) - 1e3 / nominal))
        curves.append((f"{name} ({nominal:.0f} Hz)", np.maximum(off, 1e-3), 1.0 - np.arange(len(off)) / len(off)))
    labels = {"xlabel": "off the nominal interval, ms", "ylabel": "share of intervals farther off"}
    return Panel(curves, {"xscale": "log", "yscale": "log", "title": "Jitter by stream", **labels})


def _shares(times: list[float], scale: float = 1.0) -> tuple[Any, Any]:
    """The times in order, and the share that is no longer than each."""
    return np.sort(times) * scale, np.arange(1, len(times) + 1) / len(times)


def _delays(found: Trip) -> Panel:
    shown = {"back at the link": found.back, "in the key space": found.output, "any moment": found.anytime}
    curves = [(f"{name}: median {each.median:.0f} µs", *_shares(each.times)) for name, each in shown.items()]
    mean = tripped.PAPER_MEAN
    curves.append((f"paper's mean {mean:.0f} µs", np.array((mean, mean)), np.array((0.0, 1.0))))
    most = 1.05 * max(each.p99 for each in shown.values())
    labels = {"xlabel": "µs from the stick to its effect", "ylabel": "share", "title": "Round trip"}
    return Panel(curves, {"xlim": (0.0, most), **labels})


def _hand_backs(found: dict[str, Back]) -> Panel:
    curves = [(kind, *_shares(each.told.times, 1e-3)) for kind, each in found.items()]
    labels = {"xlabel": "ms to the autopilot's being told to fly", "ylabel": "share", "title": "Hand-back"}
    return Panel(curves, {"xlim": (0.0, None), **labels})


def _drift(found: Clock) -> Panel:
    curves = [(name, np.arange(1, len(off) + 1), off) for name, off in _ppm(found).items()]
    labels = {"xlabel": "run", "ylabel": "ppm faster than the autopilot's clock"}
    return Panel(curves, {"title": "Clocks beside the autopilot's", **labels})


def _way(found: Tracking) -> Panel:
    seconds = max(each.times[-1] for each in found.lemniscate.values())
    way = np.array([lemniscate(t, seconds, np.zeros(3))[0] for t in np.linspace(0.0, seconds, 2000)])
    curves = [("reference", way[:, 1], way[:, 0])]
    curves += [(who, *np.array(each.places).T[::-1]) for who, each in found.lemniscate.items()]
    labels = {"xlabel": "east, m", "ylabel": "north, m", "title": f"Lemniscate in {found.wind}"}
    return Panel(curves, {"aspect": "equal", **labels})


def _errors(found: Tracking) -> Panel:
    curves = [(f"{who}: RMS {each.rms:.2f} m", each.times, each.distances) for who, each in found.lemniscate.items()]
    labels = {"xlabel": "s", "ylabel": "m off the reference", "title": "Tracking error"}
    return Panel(curves, {"ylim": (0.0, None), **labels})
