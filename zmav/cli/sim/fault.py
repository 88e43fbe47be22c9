"""``zmav sim fault``: let something go wrong with a vehicle of a simulator that runs."""

from __future__ import annotations

import sys

import click
import msgspec

from zmav.cli.common import dump, json_option
from zmav.cli.sim.talk import control_option, remote
from zmav.errors import BadInput
from zmav.sim.faults import FaultStatus
from zmav.sim.faults.table import KINDS, make_fault, values_from_words


@click.command("fault")
@click.argument("vehicle", required=False)
@click.argument("kind", required=False)
@click.argument("parameters", nargs=-1)
@click.option("--for", "for_s", type=float, metavar="SECONDS", help="Simulated seconds.  [default: until cleared]")
@click.option("--clear", is_flag=True, help="End it; without KIND all of the vehicle's, without VEHICLE all there are.")
@control_option
@json_option
def fault(
    vehicle: str | None,
    kind: str | None,
    parameters: tuple[str, ...],
    for_s: float | None,
    clear: bool,
    control: str | None,
    as_json: bool,
) -> None:
    """Let something go wrong: 'zmav sim fault copter1 gps-glitch north=30 --for 20'. VEHICLE is a name or 'all'.
    Without any, show the faults that are on.
    """
    if clear:
        if parameters or for_s is not None:
            raise BadInput("--clear takes no parameters and no --for", field="clear", value=parameters, expected="none")
        with remote(control) as sim:
            count = sim.clear(None if vehicle == "all" else vehicle, kind)
        click.echo(f"{count} cleared")
        return
    if vehicle is None:
        with remote(control) as sim:
            _show(sim.faults(), as_json)
        return
    if kind is None:
        expected = ", ".join(KINDS)
        raise BadInput(f"which fault? There are {expected}", field="kind", value=None, expected=expected)
    values = values_from_words(parameters)
    make_fault(kind, values)  # what is wrong with the words is said before anybody is asked
    with remote(control) as sim:
        _show(sim.fault(vehicle, kind, for_s=for_s, **values), as_json)


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
