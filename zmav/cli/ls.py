"""``zmav ls``: who is there."""

from __future__ import annotations

import click
import msgspec
from rich.console import Group
from rich.text import Text

import zmav
from zmav.cli.common import Between, Work, connected, console, dump, json_option, table
from zmav.doctor.facts import facts_of
from zmav.doctor.rules import reasons

RECORDING = "recording"
"""the rule that says so: what else was wrong with it is long over"""
COLUMNS = ("vehicle", "id", "kind", "autopilot", "mode", "armed", "batt", "place", "age", "loss", "by")


@click.command("ls")
@click.option(
    "--wait", type=Between(min=0.0), default=1.0, show_default=True, help="Seconds to listen for vehicles, at most."
)
@json_option
@connected
def command(wait: float, as_json: bool) -> Work:
    """Show the vehicles: type, autopilot, mode, armed, battery, position, age and loss of their links."""

    async def look(z: zmav.Client) -> None:
        vehicles = await z.look(wait)
        if as_json:
            for vehicle in vehicles:
                state = vehicle.last_state
                known = msgspec.to_builtins(state) if state else {"name": vehicle.name}
                click.echo(dump({**known, "age": vehicle.age, "present": vehicle.present}))
        elif vehicles:
            console().print(fleet_view(vehicles))
        else:
            click.echo(f"no vehicle in fleet {z.fleet_name!r} spoke within {wait:g} s", err=True)

    return look


def fleet_view(vehicles: list[zmav.Vehicle]) -> Group:
    """The fleet as a table that fits 80 columns, and below it what is not well, by :mod:`zmav.doctor.rules`.

    A vehicle of which something is bad is red, an armed one green.
    """
    drawn = table(COLUMNS, right=("id", "batt", "age", "loss"))
    notes = []
    for vehicle in vehicles:
        found, state = reasons(facts_of(vehicle)), vehicle.last_state
        bad = any(reason.level == "bad" for reason in found)
        style = "red" if bad else "green" if state is not None and state.armed else ""
        drawn.add_row(*_row(vehicle), style=style)
        if found:
            texts = [reason.text for reason in found if reason.rule == RECORDING] or [reason.text for reason in found]
            notes.append(Text(f"{vehicle.name}: {'; '.join(texts)}", style=style))
    return Group(drawn, *notes)


def _row(vehicle: zmav.Vehicle) -> list[str]:
    """One vehicle's cells, a dash for what is not known."""
    s, age = vehicle.last_state, vehicle.age
    if s is None:
        return [vehicle.name, *["-"] * (len(COLUMNS) - 1)]
    armed = "-" if s.armed is None else ("ARMED" if s.armed else "no")
    known = (str(s.sysid or "-"), s.kind or "-", s.autopilot or "-", s.mode or "-", armed, _battery(s), _place(s))
    age_text = "-" if age is None else f"{age:.1f}s"
    return [s.name, *known, age_text, f"{s.link_loss:.0%}", s.lease.holder if s.lease else ""]


def _battery(s: zmav.VehicleState) -> str:
    if s.battery is None:
        return "-"
    if s.battery.remaining is not None:
        return f"{s.battery.remaining:.0%}"
    return "-" if s.battery.voltage is None else f"{s.battery.voltage:.1f}V"


def _place(s: zmav.VehicleState) -> str:
    if s.local:
        return "{:+.1f}N {:+.1f}E {:+.1f}D".format(*s.local)
    p = s.position
    return "-" if p is None else f"{p.lat_deg:.5f} {p.lon_deg:.5f} {p.alt_rel:+.1f}"
