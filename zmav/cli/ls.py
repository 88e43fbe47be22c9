"""``zmav ls``: who is there."""

from __future__ import annotations

import asyncio
import time

import click
import msgspec
from rich.console import Console
from rich.table import Table

import zmav
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
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
        Console().print(table(vehicles))
    else:
        click.echo(f"no vehicle in fleet {fleet!r} spoke within {wait:g} s", err=True)


def table(vehicles: list[zmav.Vehicle], title: str | None = None) -> Table:
    """The fleet as a table; a vehicle that is stale or not connected is red."""
    t = Table(title=title, box=None, pad_edge=False, header_style="bold")
    for name in ("vehicle", "id", "kind", "autopilot", "mode", "armed", "battery", "position", "age", "loss", "note"):
        t.add_column(name, justify="right" if name in ("id", "battery", "age", "loss") else "left")
    for vehicle in vehicles:
        t.add_row(*row(vehicle), style=_style(vehicle))
    return t


def _style(vehicle: zmav.Vehicle) -> str:
    state, age = vehicle.last_state, vehicle.age
    if state is None or age is None or age > 2.0 or not state.connected or state.clash:
        return "red"
    return "green" if state.armed else ""


def row(vehicle: zmav.Vehicle) -> list[str]:
    """One vehicle's cells, a dash for what is not known."""
    s, age = vehicle.last_state, vehicle.age
    if s is None:
        return [vehicle.name, *["-"] * 9, "token only: no state heard"]
    p, b = s.position, s.battery
    volts = "-" if b is None or b.voltage is None else f"{b.voltage:.1f} V"
    share = "" if b is None or b.remaining is None else f" {b.remaining:.0%}"
    if s.local:
        place = "N {:.1f} E {:.1f} D {:.1f} m".format(*s.local)
    else:
        place = "-" if p is None else f"{p.lat_deg:.6f} {p.lon_deg:.6f} {p.alt_rel:+.1f} m"
    armed = "-" if s.armed is None else ("ARMED" if s.armed else "no")
    return [
        s.name, str(s.sysid or "-"), s.kind or "-", " ".join(filter(None, (s.autopilot, s.firmware))) or "-",
        s.mode or "-", armed, volts + share, place, "-" if age is None else f"{age:.1f} s", f"{s.link_loss:.1%}",
        note(s),
    ]  # fmt: skip


def note(s: zmav.VehicleState) -> str:
    """What somebody should know first."""
    if s.clash:
        return f"CLASH: {s.clash}"
    if s.sysid is None:
        return f"link {s.link}: no autopilot heard"
    if not s.connected:
        return f"autopilot silent (link {s.link})"
    if s.lease:
        return f"commanded by {s.lease.holder}"
    return "" if s.armed or not s.not_ready else "; ".join(s.not_ready)
