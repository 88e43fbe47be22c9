"""``zmav hil``: from the simulator to the vehicle, with one fleet file."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])
_OPTIONS = (
    click.option("--file", "fleet_file", metavar="FILE", required=True, help="The fleet file (TOML), of all stages."),
    click.option("--name", required=True, help="The vehicle's name in it."),
    click.option(
        "--reports", metavar="DIR", default="hil", show_default=True, help="Where the stages' reports are kept."
    ),
)


def stage_options(command: F) -> F:
    """What every stage is told."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@click.group("hil")
def hil() -> None:
    """Take one fleet file from the simulator to the vehicle: 'zmav hil sil', then 'bench', then 'flight'.

    Each stage runs 'zmav up' from the fleet file with another link, and the first two fly the same check flight. Ends
    with 0 only where everything is well.
    """


@hil.command("sil")
@stage_options
@click.option("--ardupilot", metavar="PATH", help="Have a real ArduPilot fly it: a build tree, or a SITL program.")
@click.option("--px4", metavar="PATH", help="Have a real PX4 fly it: a build tree, or its px4 program.")
def sil_(fleet_file: str, name: str, reports: str, ardupilot: str | None, px4: str | None) -> None:
    """Fly the check flight in the simulator: 'zmav hil sil --file fleet.toml --name quad1'."""
    from agents.hil.sil import sil

    if ardupilot and px4:
        raise click.UsageError("--ardupilot or --px4, not both")
    run_stage(sil(Path(fleet_file), name, Path(reports), ardupilot=ardupilot, px4=px4))


@hil.command("bench")
@stage_options
@click.option("--device", metavar="LINK", help="The autopilot: /dev/ttyACM0...  [default: the fleet file's link]")
@click.option("--props-off", is_flag=True, help="Say that the propellers are off. Nothing is opened without it.")
def bench_(fleet_file: str, name: str, reports: str, device: str | None, props_off: bool) -> None:
    """Fly the check flight with the real autopilot, which flies a simulation: take the propellers off.

    A PX4 with SYS_HITL 1 is flown on zmav's simulator; an ArduPilot must be built for simulation on hardware. Neither
    is armed before it has shown that it drives no motor.
    """
    from agents.hil.bench import bench

    if not props_off:
        raise click.UsageError(
            "TAKE THE PROPELLERS OFF (a rover's wheels off the ground), and then say --props-off: a simulated flight "
            "is one parameter away from a real one"
        )
    run_stage(bench(Path(fleet_file), name, Path(reports), device))


@hil.command("flight")
@stage_options
@click.option("--device", metavar="LINK", help="The autopilot: /dev/ttyACM0...  [default: the fleet file's link]")
@click.option("--accept", multiple=True, metavar="PARAM", help="It may differ from the bench's; with *; repeatable.")
def flight_(fleet_file: str, name: str, reports: str, device: str | None, accept: tuple[str, ...]) -> None:
    """Look whether it may fly, and say the command that flies it; it arms nothing and sets nothing.

    Both reports must be there and green, of this fleet file and this autopilot; simulation must be off, and parameters
    as they were flown.
    """
    from agents.hil.gate import gate

    run_stage(gate(Path(fleet_file), name, Path(reports), device, accept))


def run_stage(main: Coroutine[Any, Any, int]) -> NoReturn:
    """Run it to its end and end with its code; the first SIGINT or SIGTERM cancels it, and what it then does to leave
    nothing armed is waited for.
    """

    async def body() -> int:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None

        def cancel() -> None:
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, lambda: click.echo("it is being ended: wait", err=True))
            task.cancel()

        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, cancel)
        return await main

    try:
        code = asyncio.run(body())
    except asyncio.CancelledError:
        code = 130
    sys.exit(code)
