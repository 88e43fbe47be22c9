"""``zmav terrain``: the ground for vehicles that follow it, and for what is checked against it."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from zmav import geo, wire
from zmav.cli.common import Between, Work, connected, dump, json_option
from zmav.cli.places import numbers
from zmav.cli.vehicles import Line, on_all
from zmav.errors import BadInput, TimedOut
from zmav.formats.tiles import open_source, pieces_within
from zmav.services.files.store import tiles_directory
from zmav.terrain import piece_at
from zmav.vehicle import Vehicle

LOCATED = 10.0
"""s for a vehicle to say where it is"""

from_option = click.option(
    "--from",
    "source",
    required=True,
    metavar="FOLDER|FILE.tif|URL",
    help="A folder of .hgt tiles, a GeoTIFF, or a URL with {cell} (S36E149) and {band} (S36) in it.",
)


@click.group("terrain")
def command() -> None:
    """The ground: how high it is where vehicles fly.

    'zmav terrain load "quad*" --from srtm --radius 3000', 'zmav terrain show "quad*"'.
    """


@command.command("load")
@click.argument("vehicles")
@from_option
@click.option(
    "--radius",
    type=Between(min=0.0, max=100_000.0),
    default=8000.0,
    show_default=True,
    help="m about each vehicle; an ArduPilot asks for some 6000.",
)
@click.option(
    "--area",
    metavar="S,W,N,E",
    help="Degrees, in place of what is about each.",
)
@json_option
@connected
def load(vehicles: str, source: str, radius: float, area: str | None, as_json: bool) -> Work:
    """Bring the ground aboard: 'zmav terrain load "quad*" --from dem.tif'.

    Vehicles then answer their own autopilots, whatever the network does. What a vehicle keeps stays after a restart.
    """
    heights = open_source(source, tiles_directory())
    given = None if area is None else pieces_within(heights, *numbers(area, 4, "S,W,N,E in degrees"))

    async def bring(vehicle: Vehicle, tell: Any) -> Line:
        pieces = pieces_within(heights, *await _about(vehicle, radius)) if given is None else given
        size = await vehicle.terrain.put(pieces, tell)
        return {"pieces": len(pieces), "bytes": size}

    return on_all(vehicles, "terrain", bring, lambda line: f"{line['pieces']} pieces, {line['bytes']} bytes", as_json)


@command.command("show")
@click.argument("vehicles")
@json_option
@connected
def show_(vehicles: str, as_json: bool) -> Work:
    """What vehicles keep of the ground, and what their autopilots say: 'zmav terrain show "quad*"'."""

    async def look(vehicle: Vehicle, tell: Any) -> Line:
        found: Line = msgspec.to_builtins(await vehicle.terrain.report())
        return found

    return on_all(vehicles, "terrain", look, _words, as_json)


@command.command("clear")
@click.argument("vehicles")
@json_option
@connected
def clear(vehicles: str, as_json: bool) -> Work:
    """Have vehicles forget the ground: 'zmav terrain clear quad1'. Their autopilots keep what they were told."""

    async def forget(vehicle: Vehicle, tell: Any) -> Line:
        return {"cleared": await vehicle.terrain.clear()}

    return on_all(vehicles, "terrain", forget, lambda line: f"{line['cleared']} pieces cleared", as_json)


@command.command("height")
@click.option("--at", required=True, metavar="LAT,LON", help="Degrees.")
@from_option
@json_option
def height(at: str, source: str, as_json: bool) -> None:
    """How high the ground is: 'zmav terrain height --at -35.3632,149.1652 --from srtm'."""
    lat, lon = numbers(at, 2, "LAT,LON in degrees")
    name, north, east = piece_at(lat, lon)
    piece = open_source(source, tiles_directory()).piece(name)
    found = None if piece is None else piece.height(north, east)
    if as_json:
        click.echo(dump({"height": found, "piece": name}))
    else:
        click.echo("not known" if found is None else f"{found:.1f} m above the sea")
    if found is None:
        raise SystemExit(1)


async def _about(vehicle: Vehicle, radius: float) -> tuple[float, float, float, float]:
    """South, west, north, east of what lies so many metres about a vehicle."""
    try:
        state = await vehicle.wait_until(lambda heard: heard.position is not None, LOCATED)
    except TimedOut:
        text = f"where {vehicle.name} is, is not known: give --area, or wait for its GPS"
        raise BadInput(text, field="area", value=None, expected="south,west,north,east in degrees") from None
    here = state.position
    assert here is not None
    return (*geo.to_global(here, (-radius, -radius, 0.0))[:2], *geo.to_global(here, (radius, radius, 0.0))[:2])


def _words(line: Line) -> str:
    report = msgspec.convert({k: v for k, v in line.items() if k != "vehicle"}, wire.TerrainReport)
    parts = [f"{len(report.pieces)} pieces"]
    if report.height is not None:
        parts.append(f"ground at {report.height:.0f} m, {report.above:.1f} m above it")
    if report.pending is None:
        parts.append("its autopilot has said nothing of terrain")
    else:
        parts.append(f"autopilot: {report.pending} grids pending, {report.loaded} loaded ({report.age:.0f} s ago)")
    if report.missing:
        parts.append(f"asked for and not here: {', '.join(report.missing[:6])}")
    parts += [f"{name}: {why}" for name, why in report.faults.items()]
    return "; ".join(parts)
