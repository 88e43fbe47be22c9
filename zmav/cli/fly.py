"""``zmav fly``: one constant setpoint of any level for some seconds; then hold."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any

import click

from zmav import wire
from zmav.cli import places
from zmav.cli.common import Between, F, Finite, Work, connected, json_option, tell
from zmav.cli.vehicles import one
from zmav.client import Client
from zmav.errors import BadInput, Refused
from zmav.rotation import from_euler
from zmav.services.authority.targets import group_of
from zmav.vehicle import Vehicle
from zmav.waiting import alongside

OWN = ("lease", "seq", "deadline", "frame", "segment", "home")
SETTLE = 0.5
"""s after which the vehicle's state counts the last setpoint"""


def _vector(name: str, metavar: str, text: str) -> Callable[[F], F]:
    """An option of as many numbers as its metavar has words."""

    def decorate(function: F) -> F:
        nargs = len(metavar.split())
        return click.option(f"--{name}", type=Finite(), nargs=nargs, metavar=metavar, help=text)(function)

    return decorate


@click.command("fly")
@click.argument("vehicle")
@click.option("--to", type=places.place, metavar=places.PLACE, help="Metres about the fleet's origin, and above it.")
@_vector("at", "LAT LON", "Degrees, WGS84; with --alt.")
@click.option("--alt", type=Finite(), help="With --at: metres above home.")
@click.option("--vel", type=places.motion, metavar=places.MOTION, help="m/s.")
@click.option("--acc", type=places.motion, metavar=places.MOTION, help="m/s².")
@click.option("--yaw", type=Finite(), help="Radians clockwise from north, beside a position or a velocity.")
@click.option("--yaw-rate", type=Finite(), help="rad/s.")
@_vector("rpy", "ROLL PITCH YAW", "Attitude in radians; with --thrust.")
@_vector("rates", "P Q R", "Body rates in rad/s; with --thrust.")
@click.option("--thrust", type=Finite(), help="0 to 1.")
@_vector("torque", "X Y Z", "-1 to 1 about the body's axes; with --thrust.")
@_vector("sticks", "PITCH ROLL THRUST YAW", "-1 to 1, thrust 0 to 1: MANUAL_CONTROL.")
@click.option("--rc", metavar="PWM,PWM,..", help="µs from channel 1 up; an empty one is left to the pilot's radio.")
@click.option("--servo", metavar="PWM,PWM,..", help="µs from output 1 up; an empty one is left alone.")
@click.option("--for", "seconds", type=Between(min=0.1), default=5.0, show_default=True, help="Seconds.")
@click.option("--rate", type=Between(1.0, 200.0), default=20.0, show_default=True, help="Setpoints a second.")
@click.option("--priority", type=click.IntRange(0, 100), default=0, show_default=True, help="Of the lease.")
@json_option
@connected
def command(vehicle: str, seconds: float, rate: float, priority: int, as_json: bool, **given: Any) -> Work:
    """Stream setpoints under a lease, then hold: 'zmav fly quad1 --vel 1,0,0 --for 5'.

    PX4 flies sticks in POSCTL, and is put into HOLD when they end.

    Other levels: --to 10,0,5, --rpy 0 -0.1 0 --thrust 0.5, --rates 0 0 0.3 --thrust 0.5, --sticks 0 0.2 0.5 0,
    --rc 1500,1500,1600,1500, --servo ,,1200.
    """
    fields = {name: value for name, value in _fields(given).items() if value is not None}
    if not fields:
        raise click.UsageError("give one setpoint by its options")
    point = _point(fields)
    setpoint = {name: getattr(point, name) for name in point.__struct_fields__ if name not in OWN}

    async def fly(z: Client) -> None:
        target = await one(z, vehicle)
        said: list[str] = []
        before, start, count = dict(target.state.setpoints), time.monotonic(), 0
        async with alongside(_listen(target, said, as_json)), target.lease("fly", priority=priority) as lease:
            while count / rate < seconds:  # kept by the clock and not by the pauses
                lease.setpoint(**setpoint)
                count += 1
                await asyncio.sleep(max(0.0, start + count / rate - time.monotonic()))
            flown_for = time.monotonic() - start
            await asyncio.sleep(SETTLE)
        counts = {k: n - before.get(k, 0) for k, n in target.state.setpoints.items() if n > before.get(k, 0)}
        _say(target, lease.sent, flown_for, counts, said, as_json)

    return fly


def _fields(given: dict[str, Any]) -> dict[str, Any]:
    """A setpoint's fields from the options."""
    at, rpy, sticks = given.pop("at"), given.pop("rpy"), given.pop("sticks")
    alt, given["pos"] = given.pop("alt"), given.pop("to")
    if (at is None) != (alt is None):
        raise click.UsageError("--at and --alt go together")
    if at:
        given |= {"frame": "global", "lat_deg": at[0], "lon_deg": at[1], "alt_rel": alt}
    if rpy:
        given["attitude"] = from_euler(*rpy)
    if sticks:
        given["manual"] = dict(zip("xyzr", sticks, strict=True))
    for name in ("rc", "servo"):
        if given[name] is not None:
            given[name] = _pulses(name, given[name])
    return given


def _pulses(name: str, text: str) -> list[int | None]:
    try:
        return [int(part) if part.strip() else None for part in text.split(",")]
    except ValueError:
        expected = "whole µs between commas, such as 1500,,1600"
        raise BadInput(f"--{name} {text!r}: expected {expected}", field=name, value=text, expected=expected) from None


def _point(fields: dict[str, Any]) -> wire.Setpoint:
    """The setpoint with these fields, not yet under any lease; raises :class:`BadInput` naming the fault, also for no
    level of authority, and for two at a time.
    """
    text = json.dumps({"lease": "", "seq": 0, "deadline": 0.0, **fields})
    point = wire.decode(text.encode(), wire.Setpoint, "setpoint")
    group_of(point)
    return point


async def _listen(vehicle: Vehicle, said: list[str], as_json: bool) -> None:
    """What the vehicle says of its setpoints: a refusal comes as an event, for a put has no answer."""
    async with vehicle.events() as events:
        async for event in events:
            if event.kind not in ("setpoint", "lease", "mode", "failsafe"):
                continue
            if event.kind == "setpoint":
                said.append(event.text)
            if not as_json:
                click.echo(f"{vehicle.name}: {event.text}", err=True)


def _say(vehicle: Vehicle, sent: int, seconds: float, counts: dict[str, int], said: list[str], as_json: bool) -> None:
    listed = ", ".join(f"{n} {name}" for name, n in sorted(counts.items())) or "none heard"
    line = {"vehicle": vehicle.name, "sent": sent, "seconds": round(seconds, 3), "counts": counts, "said": said}
    tell(as_json, line, f"{vehicle.name}: {sent} setpoints in {seconds:.1f} s ({listed}); mode {vehicle.state.mode}")
    if not counts.get("flown"):
        why = said[0] if said else "see 'zmav echo VEHICLE/event'"
        raise Refused(f"{vehicle.name} flew none of them: {why}", vehicle=vehicle.name, reasons=said)
