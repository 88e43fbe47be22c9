"""``zmav sim`` itself: its options, the world they make, and its run until somebody ends it."""

from __future__ import annotations

import math
import os
import signal
import sys
import traceback
from collections.abc import Callable
from typing import Any, TypeVar

import click
from rich.console import Console

from zmav.cli.sim.line import StatusLine
from zmav.cli.sim.stacks import STACK_OPTIONS, stack_vehicles
from zmav.cli.sim.values import parse_home, parse_wind
from zmav.sim import DEFAULT_READY_S, REALISTIC_READY_S, SimVehicle, World
from zmav.sim.hil.vehicle import External
from zmav.sim.remote import control_path

F = TypeVar("F", bound=Callable[..., Any])
COUNT = click.IntRange(0, 250)

_OPTIONS = (
    click.option("--copters", type=COUNT, help="How many ArduCopters.  [default: 1 where nothing else is asked for]"),
    click.option("--hexas", default=0, type=COUNT, help="How many ArduCopters on hexarotors."),
    click.option("--rovers", default=0, type=COUNT, help="How many ArduRovers."),
    click.option("--planes", default=0, type=COUNT, help="How many ArduPlanes."),
    *STACK_OPTIONS,
    click.option(
        "--endpoint", "endpoints", multiple=True, metavar="ENDPOINT",
        help="Where each is reached: ardupilot (TCP 5760, 5762 and 5763, +10·i), tcp:PORT+STEP, udp:HOST:PORT+STEP, "
        "px4 (14580+i to 14540+i and 18570+i to 14550), pty:PATH@BAUD and others; repeatable.  "
        "[default: ardupilot or px4]",
    ),
    click.option("--home", metavar="LAT,LON,AMSL,HEADING", help="Where the first stands, degrees and m."),
    click.option("--spacing", default=10.0, show_default=True, help="Metres between starts."),
    click.option(
        "--wind", default="0", metavar="SPEED[@FROM][,GUSTS]",
        help="m/s, the degrees it comes from (270: from the west, the default), and gusty, light, moderate or severe.",
    ),
    click.option("--speed", default="1", show_default=True, help="Times real time; 0 or max: as fast as it goes."),
    click.option("--lockstep", is_flag=True, help="Wait for clients that answer TIMESYNC, as 'zmav up' does."),
    click.option("--seed", default=0, show_default=True, help="Two worlds of one seed are identical."),
    click.option("--real-boot", is_flag=True, help=f"Be ready as late as the real one ({REALISTIC_READY_S:.0f} s)."),
    click.option(
        "--control", metavar="PATH", help="The control socket: a path or a name.  [default: called after the process]"
    ),
)  # fmt: skip


def run_options(command: F) -> F:
    """What a world can be told when it begins."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def run_world(
    copters: int | None, hexas: int, rovers: int, planes: int, endpoints: tuple[str, ...], home: str | None,
    spacing: float, wind: str, speed: str, lockstep: bool, seed: int, real_boot: bool, control: str | None,
    **stacks: Any,
) -> None:  # fmt: skip
    """Make the world and run it until SIGTERM, SIGINT or 'zmav sim stop'."""
    from zmav.cli.sim.talk import parse_speed

    counts = {"copter": copters or 0, "hexa": hexas, "rover": rovers, "plane": planes}
    vehicles = stack_vehicles(counts, stacks)
    if copters is None and not vehicles and not any(counts.values()):
        counts["copter"] = 1
    blows, gusts = parse_wind(wind)
    path = control_path(control)
    world = World(
        vehicles, copters=counts["copter"], hexas=counts["hexa"], rovers=counts["rover"], planes=counts["plane"],
        px4=counts["px4"], home=parse_home(home) if home else None,
        spacing_m=spacing, endpoint=endpoints or None, speed=parse_speed(speed) or math.inf, lockstep=lockstep,
        seed=seed, wind=blows, gusts=gusts, ready_s=REALISTIC_READY_S if real_boot else DEFAULT_READY_S,
    )  # fmt: skip
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: world.stop())
    try:
        world.open(path)
        announce(world)
        line = StatusLine(world.status, Console(stderr=True))
        world.say = line.say
        world.externals.listen(line.say)
        world.on_failure = lambda vehicle, error: line.say(_obituary(vehicle, error))
        with line:
            world.run()
        if world.failures:
            world.failures.clear()
            sys.exit(1)
    finally:
        world.close()


def announce(world: World) -> None:
    """Say where each vehicle is reached; nobody need be there to read it."""
    try:
        reached: list[SimVehicle | External] = [*world.vehicles, *world.externals.vehicles]
        for vehicle in reached:
            click.echo(f"{vehicle.name} (system id {vehicle.sysid}): {' '.join(vehicle.urls)}")
        sys.stdout.flush()
    except OSError:  # the reader has gone: what is buffered would fail again at the exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _obituary(vehicle: SimVehicle, error: Exception) -> str:
    told = "".join(traceback.format_exception(error)).rstrip()
    return (
        f"{told}\n{vehicle.name} has failed by a defect of the simulator; its autopilot is dead, the others go on. "
        "Please report the lines above."
    )
