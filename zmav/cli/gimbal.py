"""``zmav gimbal``: where a vehicle's gimbal looks."""

from __future__ import annotations

import math
from typing import Any

import click

from zmav import wire
from zmav.cli import places
from zmav.cli.common import Work, connected, json_option
from zmav.cli.do import order
from zmav.cli.vehicles import Line, attempt, for_each, matching, show
from zmav.client import Client
from zmav.vehicle import Vehicle

take_option = click.option("--take", is_flag=True, help="Also from somebody else who controls it.")


@click.group("gimbal")
def command() -> None:
    """Where a vehicle's gimbal looks, by its autopilot's gimbal manager. It moves the gimbal, never the vehicle.

    'zmav gimbal point quad1 --at 52.7561 -1.2461', 'zmav gimbal turn quad1 --pitch -45', 'zmav gimbal status quad1'.
    """


@command.command("point")
@click.argument("vehicles")
@click.option("--to", type=places.place, metavar=places.PLACE, help="Metres about the fleet's origin, and above it.")
@click.option("--at", type=float, nargs=2, metavar="LAT LON", help="Degrees, WGS84.")
@click.option("--alt", type=float, help="With --at: metres above home.  [default: 0]")
@click.option("--amsl", type=float, help="With --at: metres above mean sea level.")
@click.option("--vehicle", default="", help="Another vehicle, wherever it goes.")
@take_option
@json_option
@connected
def point(
    vehicles: str,
    to: wire.Vector | None,
    at: tuple[float, float] | None,
    alt: float | None,
    amsl: float | None,
    vehicle: str,
    take: bool,
    as_json: bool,
) -> Work:
    """Have it look at a place or at another vehicle, until the next order to it.

    'zmav gimbal point quad1 --to 20,0,0', 'zmav gimbal point quad1 --vehicle rover1'.
    """
    if [to is not None, at is not None, bool(vehicle)].count(True) != 1:
        raise click.UsageError("give one of --to, --at and --vehicle")
    if at is None and (alt is not None or amsl is not None):
        raise click.UsageError("--alt and --amsl go with --at")
    args: dict[str, Any] = {"pos": to, "vehicle": vehicle, "alt_rel": alt, "alt_amsl": amsl, "take": take}
    if at is not None:
        args |= {"lat_deg": at[0], "lon_deg": at[1]}
    return order(vehicles, "gimbal_point", args, as_json)


@command.command("turn")
@click.argument("vehicles")
@click.option("--pitch", type=click.FloatRange(-180.0, 180.0), required=True, help="Degrees up from the horizon.")
@click.option(
    "--yaw", type=click.FloatRange(-360.0, 360.0), default=0.0, show_default=True, help="Degrees to the right."
)
@click.option(
    "--lock", is_flag=True, help="The yaw is from north and stays; else it is from the nose and turns with it."
)
@take_option
@json_option
@connected
def turn(vehicles: str, pitch: float, yaw: float, lock: bool, take: bool, as_json: bool) -> Work:
    """Turn it to angles: 'zmav gimbal turn quad1 --pitch -45'."""
    angles = {"pitch": math.radians(pitch), "yaw": math.radians(yaw)}
    return order(vehicles, "gimbal_turn", {**angles, "lock": lock, "take": take}, as_json)


@command.command("neutral")
@click.argument("vehicles")
@take_option
@json_option
@connected
def neutral(vehicles: str, take: bool, as_json: bool) -> Work:
    """Turn it back to where it looks without orders."""
    return order(vehicles, "gimbal_neutral", {"take": take}, as_json)


@command.command("release")
@click.argument("vehicles")
@json_option
@connected
def release(vehicles: str, as_json: bool) -> Work:
    """Have it look at nothing more, and give its control back to the autopilot."""
    return order(vehicles, "gimbal_release", {}, as_json)


@command.command("status")
@click.argument("vehicles")
@json_option
@connected
def status(vehicles: str, as_json: bool) -> Work:
    """Where it looks, and who controls it."""

    async def told(vehicle: Vehicle) -> list[Line]:
        return [await attempt(vehicle.gimbal.status())]

    async def ask(z: Client) -> None:
        show(await for_each(await matching(z, vehicles), told), _words, as_json)

    return ask


def _words(line: Line) -> str:
    if "error" in line:
        return str(line["message"])
    angles = {"up": line.get("pitch"), "from the nose": line.get("yaw"), "from north": line.get("heading")}
    looks = [f"{math.degrees(angle):.0f}° {what}" for what, angle in angles.items() if angle is not None]
    at = [f"at {line['at']}"] if line["at"] else []
    stiff = [] if line["turns"] else ["no yaw axis"]
    return ", ".join([f"gimbal {line['device']}", *looks, *at, *stiff, f"controlled by {line['controller']}"])
