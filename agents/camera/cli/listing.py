"""``zmav camera list``: who offers which."""

from __future__ import annotations

import math

import click
import msgspec
from rich.table import Table

import zmav
from zmav.cli.common import console, dump, fleet_option, json_option, run, zenoh_options
from zmav.session import SessionSettings
from zmav.vision.reader import cameras
from zmav.wire import CameraInfo


@click.command("list")
@click.option("--wait", type=click.FloatRange(0.1), default=1.0, show_default=True, help="Seconds to wait for answers.")
@fleet_option
@json_option
@zenoh_options
def command(wait: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show the cameras of the fleet: what they send now, how wide they look, where the pictures come from."""
    run(_list(wait, fleet, as_json, settings))


async def _list(wait: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        found = await cameras(z, timeout=wait)
    if as_json:
        for vehicle, info in found:
            click.echo(dump({"vehicle": vehicle, **msgspec.to_builtins(info)}, pretty=False))
    elif found:
        console().print(_table(found))
    else:
        click.echo(f"no camera in fleet {fleet!r} answered within {wait:g} s", err=True)


def _table(found: list[tuple[str, CameraInfo]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("vehicle", "camera", "size", "rate", "quality", "wide", "looks", "source"):
        table.add_column(name, no_wrap=name != "source")
    for vehicle, info in found:
        wide = math.degrees(2.0 * math.atan2(0.5 * info.width, info.focal[0]))
        looks = "down" if not any(info.mount) else ",".join(f"{math.degrees(angle):.0f}°" for angle in info.mount)
        size, rate = f"{info.width}x{info.height}", f"{info.rate_hz:.3g} Hz"
        table.add_row(
            vehicle,
            info.camera,
            size,
            rate,
            str(info.quality),
            f"{wide:.0f}°",
            looks + (", levelled" if info.gimbal else ""),
            info.source,
        )
    return table
