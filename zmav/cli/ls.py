"""``zmav ls``: who is there."""

from __future__ import annotations

import asyncio
import time

import click
import msgspec
from rich.console import Group
from rich.table import Table
from rich.text import Text

import zmav
from zmav.cli.common import console, dump, fleet_option, json_option, run, zenoh_options
from zmav.session import SessionSettings


@click.command("ls")
@click.option("--wait", default=1.0, show_default=True, help="Seconds to listen for vehicles.")
@fleet_option
@json_option
@zenoh_options
def command(wait: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show the vehicles: type, autopilot, mode, armed, battery, position, age and loss of their links."""
    run(_list(wait, fleet, as_json, settings))


async def _list(wait: float, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        deadline = time.monotonic() + wait
        while (left := deadline - time.monotonic()) > 0:
            await z.news(left)
            await asyncio.sleep(0.05)
        vehicles = z.fleet()
    if as_json:
        for vehicle in vehicles:
            state = vehicle.last_state
            known = msgspec.to_builtins(state) if state else {"name": vehicle.name}
            click.echo(dump({**known, "age": vehicle.age, "present": vehicle.present}, pretty=False))
    elif vehicles:
        console().print(fleet_view(vehicles))
    else:
        click.echo(f"no vehicle in fleet {fleet!r} spoke within {wait:g} s", err=True)


def fleet_view(vehicles: list[zmav.Vehicle]) -> Group:
    """The fleet as a table that fits 80 columns, and below it what somebody should know first.

    A vehicle that is stale, silent or in a clash is red, an armed one green.
    """
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("vehicle", "id", "kind", "autopilot", "mode", "armed", "batt", "place", "age", "loss", "by"):
        right = name in ("id", "batt", "age", "loss")
        table.add_column(name, justify="right" if right else "left", no_wrap=True)
    notes = []
    for vehicle in vehicles:
        table.add_row(*row(vehicle), style=style(vehicle))
        state = vehicle.last_state
        if words := note(state) if state else "its token is there, but no state was heard":
            notes.append(Text(f"{vehicle.name}: {words}", style=style(vehicle)))
    return Group(table, *notes)


def style(vehicle: zmav.Vehicle) -> str:
    """red: do not rely on it; green: armed."""
    state, age = vehicle.last_state, vehicle.age
    if state is None or age is None or age > 2.0 or not state.connected or state.clash:
        return "red"
    return "green" if state.armed else ""


def row(vehicle: zmav.Vehicle) -> list[str]:
    """One vehicle's cells, a dash for what is not known."""
    s, age = vehicle.last_state, vehicle.age
    if s is None:
        return [vehicle.name, *["-"] * 10]
    armed = "-" if s.armed is None else ("ARMED" if s.armed else "no")
    return [
        s.name,
        str(s.sysid or "-"),
        s.kind or "-",
        s.autopilot or "-",
        s.mode or "-",
        armed,
        _battery(s),
        _place(s),
        "-" if age is None else f"{age:.1f}s",
        f"{s.link_loss:.0%}",
        s.lease.holder if s.lease else "",
    ]


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


def note(s: zmav.VehicleState) -> str:
    """What somebody should know first."""
    if s.replayed:
        return "a recording: it takes no orders"
    if s.clash:
        return f"CLASH: {s.clash}"
    if s.sysid is None:
        return f"link {s.link}: no autopilot heard"
    if not s.connected:
        return f"autopilot silent (link {s.link})"
    return "" if s.armed or not s.not_ready else "; ".join(s.not_ready)
