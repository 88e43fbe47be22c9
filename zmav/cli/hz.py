"""``zmav hz``: how often keys are published, and how many bytes they carry."""

from __future__ import annotations

import asyncio
import itertools
import statistics
import time
from collections import defaultdict
from typing import Any

import click
import zenoh

from zmav import keys
from zmav.cli.common import Work, connected, dump, json_option, seconds_option, show_table
from zmav.client import Client
from zmav.errors import Stale

COLUMNS = ("key", "count", "hz", "min_ms", "max_ms", "stdev_ms", "bytes_per_s", "mean_bytes")


@click.command("hz")
@click.argument("key")
@seconds_option
@json_option
@connected
def command(key: str, seconds: float, as_json: bool) -> Work:
    """Measure the rate and the payload bandwidth of every key that matches ('quad1/**', 'zmav/**')."""

    async def measure(z: Client) -> None:
        expression = keys.expression(key, z.fleet_name)
        times, sizes = defaultdict[str, list[float]](list), defaultdict[str, int](int)

        def take(sample: zenoh.Sample) -> None:
            """On Zenoh's thread, so that what is timed is the arrival."""
            if keys.hears(expression, heard := str(sample.key_expr)):
                times[heard].append(time.perf_counter())
                sizes[heard] += len(sample.payload)

        subscriber = z.session.declare_subscriber(expression, take)
        await asyncio.sleep(seconds)
        subscriber.undeclare()
        if not times:
            raise Stale(f"nothing was published on {expression} within {seconds:g} s; 'zmav ls' shows who is there")
        rows = [_row(heard, at, sizes[heard], seconds) for heard, at in sorted(times.items())]
        if as_json:
            for row in rows:
                click.echo(dump(row))
        else:
            show_table(COLUMNS, ([_cell(row.get(column)) for column in COLUMNS] for row in rows), COLUMNS[1:])

    return measure


def _row(key: str, times: list[float], size: int, seconds: float) -> dict[str, Any]:
    """Mean rate, the spread of the intervals in milliseconds, and bytes."""
    gaps = [1e3 * (b - a) for a, b in itertools.pairwise(times)]
    row: dict[str, Any] = {"key": key, "count": len(times), "hz": None}
    if gaps:
        row["hz"] = 1e3 * len(gaps) / sum(gaps) if sum(gaps) else None
        row |= {"min_ms": min(gaps), "max_ms": max(gaps), "stdev_ms": statistics.pstdev(gaps)}
    return {**row, "bytes_per_s": size / seconds, "mean_bytes": size / len(times)}


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
