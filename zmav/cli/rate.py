"""``zmav rate``: what messages come, how often, for whom; and one message at a rate, for as long as it is watched."""

from __future__ import annotations

import asyncio
import time

import click
import msgspec
from rich.table import Table

import zmav
from zmav import wire
from zmav.cli.common import console, dump, fleet_option, json_option, run, zenoh_options
from zmav.errors import BadInput
from zmav.mavlink import MavMessage
from zmav.session import SessionSettings
from zmav.subscription import Subscription

WAIT_S = 3.0


@click.command("rate")
@click.argument("vehicle")
@click.argument("message", required=False)
@click.argument("hz", required=False, type=float)
@click.option("--for", "seconds", type=click.FloatRange(min=0.1), help="End after that many seconds (with MESSAGE HZ).")
@fleet_option
@json_option
@zenoh_options
def command(
    vehicle: str,
    message: str | None,
    hz: float | None,
    seconds: float | None,
    fleet: str,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    """Message rates of a vehicle: 'zmav rate quad1'. With a message and a rate, have the autopilot send it that fast
    until Ctrl-C, and show what arrives: 'zmav rate quad1 ATTITUDE 50'.
    """
    if message is None:
        run(_table(vehicle, fleet, as_json, settings))
    elif hz is None:
        raise BadInput(f"at which rate? For example 'zmav rate {vehicle} {message} 10'", field="hz", expected="Hz")
    else:
        run(_hold(vehicle, message, hz, seconds, fleet, as_json, settings))


async def _table(name: str, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        (vehicle,) = await z.wait_for(name, timeout=WAIT_S)
        table = await vehicle.rates.table()
    if as_json:
        click.echo(dump(msgspec.to_builtins(table), pretty=False))
    else:
        console().print(drawn(table))
        click.echo(summary(table), err=True)


def drawn(table: wire.RateTable) -> Table:
    """The table for a person; the vehicle's own floor is marked, as is what is slowed or refused."""
    shown = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("message", "from", "Hz", "B/s", "count", "age", "asked", "wanted", "for", ""):
        right = column in ("Hz", "B/s", "count", "age", "asked", "wanted")
        shown.add_column(column, justify="right" if right else "left", no_wrap=column != "for")
    for m in sorted(table.messages, key=lambda m: (-m.bytes_rate, m.name)):
        source = "-" if m.compid is None else f"{m.sysid}/{m.compid}"
        note = f"refused: {m.refused}" if m.refused else "slowed: link full" if m.shed else ""
        rates = (_number(m.age), _number(m.asked_hz), _number(m.wanted_hz))
        shown.add_row(
            m.name, source, f"{m.hz:.1f}", f"{m.bytes_rate:.0f}", str(m.count), *rates, " ".join(m.readers), note
        )
    return shown


def summary(table: wire.RateTable) -> str:
    """What the link carries, of what it can, and who is not seen."""
    text = f"{table.used:.0f} bytes/s"
    if table.capacity is not None:
        text += f" of {table.capacity:.0f} ({100 * table.used / table.capacity:.0f} %)"
    return text + (f"; {table.junk} wishes made no sense" if table.junk else "")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


async def _hold(
    name: str, message: str, hz: float, seconds: float | None, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Read it, and say every second how much of it came."""
    async with zmav.open(fleet=fleet, settings=settings) as z:
        (vehicle,) = await z.wait_for(name, timeout=WAIT_S)
        end = time.monotonic() + (seconds or float("inf"))
        async with vehicle.stream(message, hz=hz) as stream:
            counter = asyncio.create_task(_count(stream, counted := [0]))
            try:
                while (left := end - time.monotonic()) > 0:
                    counted[0], start = 0, time.monotonic()
                    await asyncio.sleep(min(1.0, left))
                    arrived = counted[0] / (time.monotonic() - start)
                    row = _row(await vehicle.rates.table(), message)
                    _show(message, arrived, row, as_json)
            finally:
                counter.cancel()


async def _count(stream: Subscription[MavMessage], counted: list[int]) -> None:
    async for _ in stream:
        counted[0] += 1


def _row(table: wire.RateTable, message: str) -> wire.MessageRate | None:
    """The autopilot's row: the one that has a wish."""
    rows = [m for m in table.messages if m.name == message]
    return next((m for m in rows if m.wanted_hz is not None), rows[0] if rows else None)


def _show(message: str, arrived: float, row: wire.MessageRate | None, as_json: bool) -> None:
    if as_json:
        rest = msgspec.to_builtins(row) if row else {}
        click.echo(dump({**rest, "name": message, "arrived_hz": arrived}, pretty=False))
        return
    text = f"{message} {arrived:.1f} Hz"
    if row is not None:
        text += f", {_number(row.asked_hz)} asked, {_number(row.wanted_hz)} wanted"
        text += f"; refused: {row.refused}" if row.refused else "; slowed: the link is full" if row.shed else ""
    click.echo(text)
