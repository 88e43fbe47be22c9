"""``zmav hz``: how often keys are published."""

from __future__ import annotations

import asyncio
import itertools
import statistics
import time
from collections import defaultdict
from typing import Any

import click
import zenoh
from rich.table import Table

import zmav
from zmav import keys
from zmav.cli.common import console, dump, fleet_option, json_option, run, seconds_option, zenoh_options
from zmav.errors import Stale
from zmav.session import SessionSettings


class Meter:
    """Arrival times and sizes by key; fed by Zenoh's thread, so that what is timed is the arrival."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = defaultdict(list)
        self.sizes: dict[str, int] = defaultdict(int)

    def __call__(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        self.times[key].append(time.perf_counter())
        self.sizes[key] += len(sample.payload)


async def measure(key: str, seconds: float, fleet: str, settings: SessionSettings) -> Meter:
    """Listen to a key expression for ``seconds``; raises :class:`Stale` where nothing came."""
    meter, expression = Meter(), keys.expression(key, fleet)
    async with zmav.open(fleet=fleet, settings=settings) as z:

        def take(sample: zenoh.Sample) -> None:
            if keys.hears(expression, str(sample.key_expr)):
                meter(sample)

        subscriber = z.session.declare_subscriber(expression, take)
        await asyncio.sleep(seconds)
        subscriber.undeclare()
    if not meter.times:
        raise Stale(f"nothing was published on {expression} within {seconds:g} s; 'zmav ls' shows who is there")
    return meter


def rates(meter: Meter) -> list[dict[str, Any]]:
    """Mean rate and the spread of the intervals in milliseconds, by key."""
    rows = []
    for key, times in sorted(meter.times.items()):
        gaps = [1e3 * (b - a) for a, b in itertools.pairwise(times)]
        row: dict[str, Any] = {"key": key, "count": len(times), "hz": None}
        if gaps:
            row["hz"] = 1e3 * len(gaps) / sum(gaps) if sum(gaps) else None
            row |= {"min_ms": min(gaps), "max_ms": max(gaps), "stdev_ms": statistics.pstdev(gaps)}
        rows.append(row)
    return rows


@click.command("hz")
@click.argument("key")
@seconds_option
@fleet_option
@json_option
@zenoh_options
def command(key: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Measure the rate of every key that matches ('quad1/**', 'zmav/**')."""
    run(_hz(key, seconds, fleet, as_json, settings))


async def _hz(key: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    found = rates(await measure(key, seconds, fleet, settings))
    show(found, as_json, ("key", "count", "hz", "min_ms", "max_ms", "stdev_ms"))


def show(rows: list[dict[str, Any]], as_json: bool, columns: tuple[str, ...]) -> None:
    """Rows as JSON lines or as a table of three significant digits."""
    if as_json:
        for row in rows:
            click.echo(dump(row, pretty=False))
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column, justify="left" if column in ("key", "vehicle") else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(row.get(column)) for column in columns))
    console().print(table)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
