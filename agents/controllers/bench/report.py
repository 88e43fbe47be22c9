"""What was measured, as a table beside the paper's figures, as JSON and as pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from rich.table import Table

from agents.controllers.bench import links as linked
from agents.controllers.bench import trip as tripped
from agents.controllers.bench.clock import Clock
from agents.controllers.bench.cpu import Cpu
from agents.controllers.bench.flight import lemniscate
from agents.controllers.bench.handback import Back
from agents.controllers.bench.links import Links
from agents.controllers.bench.spread import Spread
from agents.controllers.bench.tracking import PX4, Tracking
from agents.controllers.bench.trip import Trip

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = tuple[str, str, str]
"""what, its figures, and the paper's figure or the aim"""


class Machine(msgspec.Struct):
    """What the figures are of."""

    processors: int
    loads: dict[str, tuple[float, float]]
    """by measurement: runnable tasks over a minute, before and after it"""


class Report(msgspec.Struct):
    """None: not measured. ``failed``: by measurement, why it has no figures."""

    t: float
    machine: Machine
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
        before, after = report.machine.loads.get(name, (0.0, 0.0))
        about = f"load {before:.1f} to {after:.1f} on {report.machine.processors} processors"
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
    named = {"sum of the controller's dt": found.integrated, "State.t": found.stated, "this machine": found.host}
    rows = []
    for name, ratios in named.items():
        off = [1e6 * (each - 1.0) for each in ratios]
        text = (
            f"median {np.median(off):+.0f} ppm, {min(off):+.0f} to {max(off):+.0f} of {len(off)} × {found.seconds:g} s"
        )
        rows.append((f"{name} / autopilot's clock", text, "1"))
    return [*rows, ("runs left out", str(found.broken), "")] if found.broken else rows


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


def save(report: Report, folder: Path) -> list[Path]:
    """bench.json and a picture of each measurement; gives their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "bench.json"
    path.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1))
    return [path, *pictures(report, folder)]


def pictures(report: Report, folder: Path) -> list[Path]:
    """One a measurement."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    saved = []

    def draw(name: str, columns: int, *panels: tuple[Any, Any]) -> None:
        figure = Figure(figsize=(6.0 * columns, 4.2), layout="constrained")
        for index, (panel, data) in enumerate(panels):
            panel(figure.add_subplot(1, columns, index + 1), data)
        saved.append(folder / f"{name}.png")
        figure.savefig(saved[-1], dpi=110)

    if report.links:
        draw("links", 1, (_draw_links, report.links))
    if report.trip and report.handback:
        draw("trip", 2, (_draw_trip, report.trip), (_draw_backs, report.handback))
    elif report.trip:
        draw("trip", 1, (_draw_trip, report.trip))
    if report.clock:
        draw("clock", 1, (_draw_clock, report.clock))
    if report.cpu:
        draw("cpu", 1, (_draw_cpu, report.cpu))
    if report.tracking and report.tracking.lemniscate:
        draw("tracking", 2, (_draw_way, report.tracking), (_draw_errors, report.tracking))
    return saved


def _draw_links(axes: Axes, found: Links) -> None:
    for name, each in found.streams.items():
        nominal = linked.NOMINAL.get(name, linked.SIGNALS_HZ if name == linked.SIGNALS else 250.0)
        off = np.sort(np.abs(np.array(each.gaps) - 1e3 / nominal))
        axes.plot(np.maximum(off, 1e-3), 1.0 - np.arange(len(off)) / len(off), label=f"{name} ({nominal:.0f} Hz)")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="off the nominal interval, ms",
        ylabel="share of intervals farther off",
        title="Jitter by stream",
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower left")


def _draw_trip(axes: Axes, found: Trip) -> None:
    shown = {"back at the link": found.back, "in the key space": found.output, "any moment": found.anytime}
    for name, each in shown.items():
        times = np.sort(each.times)
        share = np.arange(1, len(times) + 1) / len(times)
        axes.plot(times, share, label=f"{name}: median {each.median:.0f} µs")
    axes.axvline(tripped.PAPER_MEAN, color="black", linestyle=":", label=f"paper's mean {tripped.PAPER_MEAN:.0f} µs")
    most = 1.05 * max(each.p99 for each in shown.values())
    axes.set(xlim=(0.0, most), xlabel="µs from the stick to its effect", ylabel="share", title="Round trip")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower right")


def _draw_backs(axes: Axes, found: dict[str, Back]) -> None:
    for index, each in enumerate(found.values()):
        times = np.array(each.told.times) / 1e3
        spread_out = index + np.linspace(-0.25, 0.25, len(times))
        axes.plot(times, spread_out, "o", markersize=3, color=f"C{index}")
        axes.plot([each.told.median / 1e3] * 2, [index - 0.35, index + 0.35], color="black")
    axes.set_yticks(range(len(found)), list(found))
    axes.invert_yaxis()
    axes.set(xlabel="ms to the autopilot's being told to fly", title="Hand-back (bar: median)", xlim=(0.0, None))
    axes.grid(alpha=0.3, axis="x")


def _draw_clock(axes: Axes, found: Clock) -> None:
    named = {"sum of dt": found.integrated, "State.t": found.stated, "this machine": found.host}
    for name, ratios in named.items():
        axes.plot(range(1, len(ratios) + 1), [1e6 * (each - 1.0) for each in ratios], "o-", label=name, markersize=4)
    axes.axhline(0.0, color="black", linewidth=0.5)
    axes.set(xlabel="run", ylabel="ppm faster than the autopilot's clock", title="Clocks beside the autopilot's")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _draw_cpu(axes: Axes, found: Cpu) -> None:
    bars = axes.barh(list(found.percent), list(found.percent.values()))
    axes.bar_label(bars, fmt="%.1f %%", padding=3)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    missed = f"{found.late} of {found.cycles} cycles late"
    axes.set(xlabel="% of a processor", title=f"Aggressive flight of {found.seconds:.0f} s, 250 Hz: {missed}")


def _draw_way(axes: Axes, found: Tracking) -> None:
    seconds = max(each.times[-1] for each in found.lemniscate.values())
    way = np.array([lemniscate(t, seconds, np.zeros(3))[0] for t in np.linspace(0.0, seconds, 2000)])
    axes.plot(way[:, 1], way[:, 0], color="black", linewidth=0.8, linestyle="--", label="reference")
    for who, each in found.lemniscate.items():
        north, east = np.array(each.places).T
        axes.plot(east, north, label=who, linewidth=0.9)
    axes.set(xlabel="east, m", ylabel="north, m", title=f"Lemniscate in {found.wind}", aspect="equal")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper right")


def _draw_errors(axes: Axes, found: Tracking) -> None:
    for who, each in found.lemniscate.items():
        axes.plot(each.times, each.distances, label=f"{who}: RMS {each.rms:.2f} m", linewidth=0.9)
    axes.set(xlabel="s", ylabel="m off the reference", title="Tracking error", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper right")
