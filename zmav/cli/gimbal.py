"""``zmav gimbal``: where a vehicle's gimbal looks."""

from __future__ import annotations

import math
from typing import Any

import click

from zmav.cli import places
from zmav.cli.common import Between, Finite, Work, connected, json_option
from zmav.cli.do import order
from zmav.wire import Vector

Degrees = Between(-360.0, 360.0)


@click.command("gimbal")
@click.argument("vehicles")
@click.option("--to", type=places.place, metavar=places.PLACE, help="A place: metres about the fleet's origin.")
@click.option("--at", type=Finite(), nargs=2, metavar="LAT LON", help="A place: degrees, WGS84.")
@click.option("--alt", type=Finite(), help="With --at: metres above home.  [default: 0]")
@click.option("--vehicle", help="Another vehicle, wherever it goes.")
@click.option("--pitch", type=Degrees, help="Degrees up from the horizon.")
@click.option("--yaw", type=Degrees, help="With --pitch: degrees to the right of the nose.  [default: 0]")
@click.option("--lock", is_flag=True, help="With --pitch: the yaw is from north, and stays.")
@click.option("--neutral", is_flag=True, help="Where it looks without orders.")
@click.option("--release", is_flag=True, help="Look at nothing more, and give its control back.")
@click.option("--take", is_flag=True, help="Also from somebody else who controls it.")
@json_option
@connected
def command(
    vehicles: str,
    to: Vector | None,
    at: tuple[float, float] | None,
    alt: float | None,
    vehicle: str | None,
    pitch: float | None,
    yaw: float | None,
    lock: bool,
    neutral: bool,
    release: bool,
    take: bool,
    as_json: bool,
) -> Work:
    """Where a gimbal looks: 'zmav gimbal quad1 --at 52.7561 -1.2461', 'zmav gimbal quad1 --pitch -45'.

    Without an option: where it looks, and who controls it. A place or a vehicle is looked at until the next order. It
    is the autopilot's gimbal manager that is told, and never the vehicle that is moved.
    """
    given = [to is not None, at is not None, vehicle is not None, pitch is not None, neutral, release]
    if sum(given) > 1:
        raise click.UsageError("give one of --to, --at, --vehicle, --pitch, --neutral and --release")
    if (alt is not None and at is None) or ((yaw is not None or lock) and pitch is None):
        raise click.UsageError("--alt goes with --at, --yaw and --lock go with --pitch")
    if take and not any(given[:5]):
        raise click.UsageError("--take goes with what moves it")
    if not any(given) or release:
        return order(vehicles, "gimbal_release" if release else "gimbal_status", {}, as_json)
    if pitch is not None or neutral:
        up = None if pitch is None else math.radians(pitch)
        angles = {"pitch": up, "yaw": math.radians(yaw or 0.0), "lock": lock, "take": take}
        return order(vehicles, "gimbal_turn", angles, as_json)
    args: dict[str, Any] = {"pos": to, "vehicle": vehicle or "", "alt_rel": alt, "take": take}
    args |= {} if at is None else {"lat_deg": at[0], "lon_deg": at[1]}
    return order(vehicles, "gimbal_point", args, as_json)
