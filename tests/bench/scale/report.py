"""The tables of a study. What was measured and what a line was laid through stand in columns of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tests.bench.scale.fit import COSTS, LIMITS, STRAIGHT, SYSTEM_IDS, bend, fit
from tests.bench.scale.footprint import STREAMED
from tests.bench.scale.study import Run


def report(runs: Sequence[Run]) -> RenderableType:
    """Everything a study found."""
    flat = [run for run in runs if not run.shape.groups]
    grouped = [run for run in runs if run.shape.groups]
    tables: list[RenderableType] = [measured(runs)]
    if len(flat) > 1:
        tables += [fitted(flat), limits(flat)]
    if grouped and flat:
        tables.append(compared(flat, grouped))
    return Group(*tables)


def measured(runs: Sequence[Run]) -> RenderableType:
    """One line a run."""
    table = _table(
        "measured",
        "vehicles",
        "routers",
        "groups",
        "form",
        "re-sync",
        "in",
        "idle",
        "to the ground",
        "states",
        "RSS",
        "station CPU",
        "all states",
        "all tokens",
        "order",
        "worst",
        "late",
    )
    for run in runs:
        shape = run.shape
        table.add_row(
            str(shape.vehicles),
            f"{shape.routers} {shape.topology}",
            str(shape.groups or "-"),
            f"{run.form:.1f} s",
            f"{run.sync_bytes / 1e3:.0f} kB",
            f"{run.sync:.1f} s",
            f"{run.idle_rate / 1e3:.2f} kB/s",
            f"{run.trunk_rate / 1e3:.1f} kB/s",
            f"{run.states:.0f}/{run.offered:.0f} Hz",
            f"{run.rss_ground / 1e6:.0f} MB",
            f"{run.station_cpu:.1%}",
            _ms(run.ask if run.ask_answers else None),
            _ms(run.history if run.history_answers else None),
            _ms(run.ping),
            _ms(run.ping_worst),
            str(run.late),
        )
    raw = f"one vehicle's raw telemetry crosses beside it: {len(STREAMED)} messages, {runs[-1].raw:.0f} frames/s here"
    return Group(table, Text(raw))


def fitted(runs: Sequence[Run]) -> RenderableType:
    """A straight line through the runs, for each cost, beside the largest run."""
    largest = max(runs, key=lambda run: run.shape.vehicles)
    table = _table(
        "flat key space",
        "cost",
        f"measured at {largest.shape.vehicles}",
        "fitted: fixed",
        "per vehicle",
        "worst miss",
        "fitted at 1000",
    )
    for cost in COSTS:
        line, value = fit(runs, cost), cost.of(largest)
        if line is None or value is None:
            continue
        there = f"{line.at(1000):.4g} {cost.unit}" if line.worst <= STRAIGHT else "no line"
        table.add_row(
            cost.name,
            f"{value * cost.scale:.4g} {cost.unit}",
            f"{line.fixed:.4g}",
            f"{line.each:.4g}",
            f"{line.worst:.0%}",
            there,
        )
    return table


def limits(runs: Sequence[Run]) -> RenderableType:
    """What is full first, in order; nothing here was measured, but reckoned from what was."""
    by_name = {cost.name: cost for cost in COSTS}
    found = [("MAVLink's system ids", float(SYSTEM_IDS), "the protocol")]
    for limit in LIMITS:
        cost = by_name[limit.cost]
        line, curve = fit(runs, cost), bend(runs, cost)
        if line is not None and line.worst <= STRAIGHT:
            found.append((limit.what, line.reaches(limit.full), "fitted line"))
        elif curve is not None:
            found.append((limit.what, curve.reaches(limit.full), f"power {curve.power:.1f} of the two largest"))
    table = _table("where the flat key space ends", "what is full", "at so many vehicles", "by")
    for what, vehicles, by in sorted(found, key=lambda each: each[1]):
        table.add_row(what, "never" if math.isinf(vehicles) else f"{max(vehicles, 0.0):.0f}", by)
    return table


def compared(flat: Sequence[Run], grouped: Sequence[Run]) -> RenderableType:
    """The same fleet flat and in groups, where both were run."""
    table = _table("flat and in groups, measured", "cost", *(_title(run) for run in (*flat, *grouped)))
    for cost in COSTS:
        values = [cost.of(run) for run in (*flat, *grouped)]
        table.add_row(
            f"{cost.name}, {cost.unit}", *("-" if value is None else f"{value * cost.scale:.4g}" for value in values)
        )
    return table


def _title(run: Run) -> str:
    groups = f" in {run.shape.groups}" if run.shape.groups else ""
    return f"{run.shape.vehicles}{groups}"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, header_style="bold")
    for i, name in enumerate(columns):
        table.add_column(name, justify="left" if i == 0 else "right")
    return table


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.1f} ms"
