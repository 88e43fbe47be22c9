"""``zmav sim``: simulated vehicles to fly."""

from __future__ import annotations

import math
import signal
import sys

import click
from rich.console import Console
from rich.live import Live

from zmav.sim import DEFAULT_READY_S, REALISTIC_READY_S, Home, World, WorldStatus


@click.command("sim")
@click.option("--copters", type=click.IntRange(0, 250), help="How many ArduCopters.  [default: 1, beside --px4: 0]")
@click.option("--px4", default=0, type=click.IntRange(0, 250), help="How many PX4 quadrotors.")
@click.option(
    "--endpoint", "endpoints", multiple=True,
    help="Where each is reached: tcp (5760+10·i), tcp:PORT+STEP, udp:HOST:PORT+STEP, px4 (14580+i to 14540+i and "
    "18570+i to 14550); repeatable.  [default: tcp for ArduCopters, px4 for PX4s]",
)  # fmt: skip
@click.option("--home", type=float, nargs=4, metavar="LAT LON AMSL YAW", help="Where the first stands, degrees and m.")
@click.option("--spacing", default=10.0, show_default=True, help="Metres between starts, in a row to the east.")
@click.option("--wind", type=float, nargs=2, default=(0.0, 0.0), metavar="N E", help="m/s, where it blows to.")
@click.option(
    "--speed", type=click.FloatRange(min=0.0), default=1.0, show_default=True,
    help="Times real time; 0: as fast as it goes.",
)  # fmt: skip
@click.option("--seed", default=0, show_default=True)
@click.option("--real-boot", is_flag=True, help=f"Be ready as late as the real one ({REALISTIC_READY_S:.0f} s).")
def command(
    copters: int | None, px4: int, endpoints: tuple[str, ...], home: tuple[float, float, float, float] | None,
    spacing: float, wind: tuple[float, float], speed: float, seed: int, real_boot: bool,
) -> None:  # fmt: skip
    """Simulate copters that speak as ArduPilot does: 'zmav sim', then 'zmav up --link tcp:127.0.0.1:5760'; or as PX4
    does: 'zmav sim --px4 1', then 'zmav up --link udpin:127.0.0.1:14540'.
    """
    if copters is None:
        copters = 0 if px4 else 1
    world = World(
        copters=copters, px4=px4, home=Home(*home) if home else None, spacing_m=spacing, endpoint=endpoints or None,
        speed=speed or math.inf, seed=seed, wind=(wind[0], wind[1], 0.0),
        ready_s=REALISTIC_READY_S if real_boot else DEFAULT_READY_S,
    )  # fmt: skip
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: world.stop())
    console = Console(stderr=True)
    try:
        world.open()
        for vehicle in world.vehicles:
            click.echo(f"{vehicle.name} (system id {vehicle.sysid}): {' '.join(vehicle.urls)}")
        sys.stdout.flush()
        with Live(
            get_renderable=lambda: _line(world.status()), console=console, auto_refresh=console.is_terminal,
            refresh_per_second=1, transient=True,
        ):  # fmt: skip
            world.run()
    finally:
        world.close()


def _line(status: WorldStatus) -> str:
    flying = sum(v.armed for v in status.vehicles)
    clock = f"{status.time_s:.0f} s simulated at ×{status.speed_reached:.1f}"
    return f"{clock}, {len(status.vehicles)} vehicles, {flying} armed"
