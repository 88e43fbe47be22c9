"""``zmav sim status|pause|resume|speed|step|stop|pilot|fault``: words to a simulator that runs."""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable
from typing import Any

import click
import msgspec

from zmav.cli.common import Finite, dump, json_option, show_table
from zmav.errors import BadInput
from zmav.sim.faults import FaultStatus
from zmav.sim.faults.table import KINDS, make_fault, values_from_words
from zmav.sim.remote import Remote
from zmav.sim.status import VehicleStatus, WorldStatus
from zmav.sim.values import parse_speed

COLUMNS = ("vehicle", "sysid", "autopilot", "mode", "armed", "height", "speed", "battery", "faults", "reached at")


def clock_words(status: WorldStatus) -> str:
    """The clock, for a person: where it is, how fast it goes, and whether that is what was asked for."""
    asked = "max" if status.speed is None else f"×{status.speed:g}"
    if status.paused:
        return f"{status.time_s:.1f} s simulated, paused"
    words = f"{status.time_s:.0f} s simulated"
    if status.speed_reached:
        words += f" at ×{status.speed_reached:.1f}"
    elif status.speed is not None:
        words += f" at {asked}"
    if status.lockstep:
        words += ", in lock step"
    if status.behind:
        words += f", BEHIND the {asked} asked for"
    elif status.speed is None:
        words += " (max)"
    return words


Work = Callable[[Remote], WorldStatus | None]
"""what a verb does with the simulator, and how the world is then, where that is to be told"""


def to_simulator(verb: Callable[..., Work]) -> Callable[..., None]:
    """The body of a verb for the simulator of ``--control``, before or after the verb: it looks at its options and
    gives back what is to be done, before anybody is asked.
    """

    @click.option("--control", metavar="PATH", help="Which simulator.  [default: the only one that runs]")
    @functools.wraps(verb)
    def wrapped(control: str | None, **options: Any) -> None:
        work = verb(**options)
        with Remote(control or click.get_current_context().obj) as sim:
            found = work(sim)
        if found is not None:
            click.echo(clock_words(found))

    return wrapped


@click.command("status")
@to_simulator
@json_option
def status(as_json: bool) -> Work:
    """Show the world's clock and every vehicle."""

    def show(sim: Remote) -> WorldStatus | None:
        found = sim.status()
        if as_json:
            click.echo(dump(msgspec.to_builtins(found), pretty=sys.stdout.isatty()))
            return None
        show_table(COLUMNS, map(_row, found.vehicles), right=("sysid", "height", "speed", "battery"))
        return found

    return show


def _row(v: VehicleStatus) -> tuple[str, ...]:
    trouble = " ".join((*v.faults, *(["FAILED"] if v.failed else [])))
    armed = "flying" if v.flying else "armed" if v.armed else "ready" if v.ready else "-"
    return (
        v.name,
        str(v.sysid),
        f"{v.autopilot} {v.airframe}",
        v.mode,
        armed,
        f"{v.height_m:.1f} m",
        f"{v.speed_mps:.1f} m/s",
        f"{v.battery_pct} %",
        trouble or "-",
        " ".join(v.urls),
    )


@click.command("pause")
@to_simulator
def pause() -> Work:
    """Stop simulated time."""
    return Remote.pause


@click.command("resume")
@to_simulator
def resume() -> Work:
    """Go on after a pause."""
    return Remote.resume


@click.command("speed")
@click.argument("times")
@to_simulator
def speed(times: str) -> Work:
    """Go on at TIMES real time; 'max' or 0: as fast as it goes."""
    asked = parse_speed(times)
    return lambda sim: sim.speed(asked if math.isfinite(asked) else 0.0)


@click.command("step")
@click.argument("seconds", type=Finite())
@to_simulator
def step(seconds: float) -> Work:
    """Go on for SECONDS of simulated time, and pause."""
    return lambda sim: sim.step(seconds)


@click.command("stop")
@to_simulator
def stop() -> Work:
    """End the simulator."""
    return Remote.stop


@click.command("pilot")
@click.argument("vehicle")
@click.argument("channels", nargs=-1, metavar="[CHANNEL=PWM]...")
@click.option("--mode", help="What the mode switch is turned to: one of the modes on it.")
@to_simulator
def pilot(vehicle: str, channels: tuple[str, ...], mode: str | None) -> Work:
    """Turn the pilot's switches: 'zmav sim pilot hex1 7=1900', 'zmav sim pilot quad1 --mode LOITER'.

    Channels (1 to 8) are pulse widths in us. Where nothing is said, a PX4's radio is off: the first use turns it on.
    """
    set_to = dict(map(_channel, channels))
    if not set_to and mode is None:
        expected = "--mode MODE or CHANNEL=PWM"
        raise BadInput(f"what does the pilot do? {expected}", field="channels", value=None, expected=expected)
    return lambda sim: sim.pilot(vehicle, mode, set_to)


def _channel(text: str) -> tuple[int, int]:
    number, _, pwm = text.partition("=")
    try:
        return int(number), int(pwm)
    except ValueError:
        expected = "CHANNEL=PWM, as in 7=1900"
        raise BadInput.wrong("channels", text, expected, f"{text!r}") from None


@click.command("fault")
@click.argument("vehicle", required=False)
@click.argument("kind", required=False)
@click.argument("parameters", nargs=-1)
@click.option("--for", "for_s", type=Finite(), metavar="SECONDS", help="Simulated seconds.  [default: until cleared]")
@click.option("--clear", is_flag=True, help="End it; without KIND all of the vehicle's, without VEHICLE all there are.")
@to_simulator
@json_option
def fault(
    vehicle: str | None,
    kind: str | None,
    parameters: tuple[str, ...],
    for_s: float | None,
    clear: bool,
    as_json: bool,
) -> Work:
    """Let something go wrong: 'zmav sim fault quad1 gps-glitch north=30 --for 20'. VEHICLE is a name or 'all'.
    Without any, show the faults that are on.
    """
    if clear:
        if parameters or for_s is not None:
            raise BadInput("--clear takes no parameters and no --for", field="clear", value=parameters, expected="none")
        return lambda sim: click.echo(f"{sim.clear(None if vehicle == 'all' else vehicle, kind)} cleared")
    if vehicle is None:
        return lambda sim: _show(sim.faults(), as_json)
    if kind is None:
        expected = ", ".join(KINDS)
        raise BadInput(f"which fault? There are {expected}", field="kind", value=None, expected=expected)
    values = values_from_words(parameters)
    make_fault(kind, values)  # what is wrong with the words is said before anybody is asked
    return lambda sim: _show(sim.fault(vehicle, kind, for_s=for_s, **values), as_json)


def _show(found: list[FaultStatus], as_json: bool) -> None:
    if as_json:
        click.echo(dump(msgspec.to_builtins(found), pretty=sys.stdout.isatty()))
        return
    if not found:
        click.echo("no faults")
    for each in found:
        words = " ".join(f"{name}={value}" for name, value in each.parameters.items())
        until = "" if each.until_s is None else f" until {each.until_s:.1f} s"
        click.echo(f"{each.vehicle}: {' '.join(filter(None, [each.kind, words]))}, since {each.since_s:.1f} s{until}")
