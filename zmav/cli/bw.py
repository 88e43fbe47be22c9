"""``zmav bw``: how many bytes keys carry."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, json_option, run, seconds_option, zenoh_options
from zmav.cli.hz import measure, show
from zmav.session import SessionSettings


@click.command("bw")
@click.argument("key")
@seconds_option
@fleet_option
@json_option
@zenoh_options
def command(key: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Measure the payload bandwidth of every key that matches, and of all together."""
    run(_bw(key, seconds, fleet, as_json, settings))


async def _bw(key: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    meter = await measure(key, seconds, fleet, settings)
    rows = [
        {"key": k, "bytes_per_s": size / seconds, "mean_bytes": size / len(meter.times[k])}
        for k, size in sorted(meter.sizes.items(), key=lambda item: -item[1])
    ]
    total, count = sum(meter.sizes.values()), sum(map(len, meter.times.values()))
    rows.append({"key": "all", "bytes_per_s": total / seconds, "mean_bytes": total / count})
    show(rows, as_json, ("key", "bytes_per_s", "mean_bytes"))
