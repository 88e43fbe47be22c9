"""``zmav rate``: what messages come, how often, and for whom."""

from __future__ import annotations

import click
import msgspec

from zmav import wire
from zmav.cli.common import Work, connected, dump, json_option, show_table
from zmav.cli.vehicles import one
from zmav.client import Client

RIGHT = ("Hz", "B/s", "count", "age", "asked", "wanted")


@click.command("rate")
@click.argument("vehicle")
@json_option
@connected
def command(vehicle: str, as_json: bool) -> Work:
    """Message rates of a vehicle: 'zmav rate quad1'. 'zmav echo quad1/ATTITUDE --rate 50' has one sent that fast."""

    async def show(z: Client) -> None:
        table = await (await one(z, vehicle)).rates.table()
        if as_json:
            click.echo(dump(msgspec.to_builtins(table)))
            return
        messages = sorted(table.messages, key=lambda m: (-m.bytes_rate, m.name))
        show_table(("message", "from", *RIGHT, "for", ""), map(_row, messages), RIGHT)
        click.echo(_summary(table), err=True)

    return show


def _row(m: wire.MessageRate) -> list[str]:
    """One message for a person; what is slowed or refused says so."""
    source = "-" if m.compid is None else f"{m.sysid}/{m.compid}"
    note = f"refused: {m.refused}" if m.refused else "slowed: link full" if m.shed else ""
    rates = ("-" if value is None else f"{value:.1f}" for value in (m.age, m.asked_hz, m.wanted_hz))
    return [m.name, source, f"{m.hz:.1f}", f"{m.bytes_rate:.0f}", str(m.count), *rates, " ".join(m.readers), note]


def _summary(table: wire.RateTable) -> str:
    """What the link carries, of what it can, and who is not seen."""
    text = f"{table.used:.0f} bytes/s"
    if table.capacity is not None:
        text += f" of {table.capacity:.0f} ({100 * table.used / table.capacity:.0f} %)"
    return text + (f"; {table.junk} wishes made no sense" if table.junk else "")
