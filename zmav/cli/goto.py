"""``zmav goto``: fly to a point."""

from __future__ import annotations

from typing import Any

import click

from zmav.cli import places
from zmav.cli.common import Finite, Work, connected, force_option, json_option
from zmav.cli.do import order
from zmav.wire import Vector


@click.command("goto")
@click.argument("vehicles")
@click.option("--to", type=places.place, metavar=places.PLACE, help="Metres about the fleet's origin, and above it.")
@click.option("--at", type=Finite(), nargs=2, metavar="LAT LON", help="Degrees, WGS84.")
@click.option("--alt", type=Finite(), help="With --at: metres above home.")
@click.option("--amsl", type=Finite(), help="With --at: metres above mean sea level.")
@click.option("--tolerance", type=Finite(), default=1.0, show_default=True, help="Metres: this close is there.")
@click.option("--speed", type=Finite(), help="m/s over the ground.  [default: the autopilot's own]")
@click.option(
    "--radius",
    type=Finite(),
    help="Metres of a plane's circle there; negative: counter-clockwise.  [default: the autopilot's own]",
)
@click.option("--no-wait", is_flag=True, help="Do not wait for the arrival.")
@force_option
@json_option
@connected
def command(
    vehicles: str,
    to: Vector | None,
    at: tuple[float, float] | None,
    alt: float | None,
    amsl: float | None,
    tolerance: float,
    speed: float | None,
    radius: float | None,
    no_wait: bool,
    force: bool,
    as_json: bool,
) -> Work:
    """Fly to a point: 'zmav goto quad1 --to 20,0,10' or 'zmav goto quad1 --at 52.7561 -1.2461 --alt 10'."""
    if (to is None) == (at is None):
        raise click.UsageError("give one of --to and --at")
    if at is not None and (alt is None) == (amsl is None):
        raise click.UsageError("with --at, give one of --alt and --amsl")
    args: dict[str, Any] = {"tolerance": tolerance, "arrive": not no_wait, "force": force}
    args |= {"speed": speed, "radius": radius}
    if to is not None:
        args |= {"frame": "ned", "pos": to}
    elif at is not None:
        args |= {"frame": "global", "lat_deg": at[0], "lon_deg": at[1], "alt_rel": alt, "alt_amsl": amsl}
    return order(vehicles, "goto", args, as_json)
