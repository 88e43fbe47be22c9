"""``zmav traffic``."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import click
import msgspec

from ground.host import host_name
from zmav.cli.common import Between, Work, connected, console, dump, json_option, seconds_option
from zmav.client import Client
from zmav.errors import BadInput, needs
from zmav.process import log
from zmav.traffic import on_earth

if TYPE_CHECKING:
    from ground.traffic.program import TrafficSettings

COLUMNS = {
    "icao": "icao",
    "callsign": "callsign",
    "m AMSL": "alt_amsl",
    "±": "alt_error",
    "by": "alt_from",
    "age s": "age",
    "nearest": "vehicle",
    "m away": "distance",
    "above m": "height",
    "in s": "time",
    "then m": "nearest",
    "source": "source",
}
"""of the list, and what stands in each"""


@click.command("traffic")
@click.argument("feeds", nargs=-1, metavar="[FEED]...")
@click.option("--at", metavar="LAT,LON", help="A place about which traffic is wanted, beside the vehicles'.")
@click.option(
    "--reach",
    type=Between(1.0, 400.0),
    default=50.0,
    show_default=True,
    help="Kilometres from a vehicle, or that place, within which aircraft are told of.",
)
@click.option(
    "--qnh",
    type=Between(850.0, 1100.0),
    help="Pressure at sea level, hPa: makes heights of pressure altitudes.",
)
@click.option(
    "--ours", multiple=True, metavar="HEX", help="ICAO address of a vehicle of the fleet that sends ADS-B (repeatable)."
)
@click.option(
    "--priority",
    type=click.IntRange(0, 255),
    default=0,
    show_default=True,
    help="Of several processes with the same feeds the highest is in charge.",
)
@click.option("--name", help="Name of this host.  [default: the credentials', or ground]")
@seconds_option
@json_option
@connected
def command(
    feeds: tuple[str, ...],
    at: str | None,
    reach: float,
    qnh: float | None,
    ours: tuple[str, ...],
    priority: int,
    name: str | None,
    seconds: float,
    as_json: bool,
) -> Work:
    """Tell the fleet who else is in the air, by receivers of ADS-B; without a feed, list what is told.

    FEED is what dump1090, readsb and others serve: sbs:HOST (BaseStation, port 30003) or beast:HOST (raw, port 30005).
    Several at once become one picture. A second process with the same feeds stands by. Vehicles warn of who comes near,
    the planner keeps clear of it, 'zmav top', the page and 'zmav doctor' show it.
    """
    if not feeds:
        return lambda z: _list(z, seconds, as_json)
    from ground.traffic.feeds import parse_feed

    found = tuple(dict.fromkeys(map(parse_feed, feeds)))
    if any(feed.kind == "beast" for feed in found):
        needs("a Beast feed", "traffic", "pyModeS")
    from ground.traffic.program import TrafficSettings

    settings = TrafficSettings(
        feeds=found,
        name=name or "",
        at=parse_at(at) if at else None,
        reach=1e3 * reach,
        qnh=qnh,
        ours=tuple(map(parse_address, ours)),
        priority=priority,
    )
    return lambda z: _serve(z, settings, as_json)


def parse_at(text: str) -> tuple[float, float]:
    """``LAT,LON``."""
    try:
        lat, lon = map(float, text.split(","))
    except ValueError:
        lat = lon = float("nan")
    if not on_earth(lat, lon):
        raise BadInput(f"no place {text!r}", field="at", value=text, expected="LAT,LON in degrees: 50.1,8.7")
    return lat, lon


def parse_address(text: str) -> int:
    if not re.fullmatch(r"[0-9A-Fa-f]{6}", text):
        raise BadInput(f"no ICAO address {text!r}", field="ours", value=text, expected="six hexadecimal digits: 3c4b12")
    return int(text, 16)


async def _list(z: Client, seconds: float, as_json: bool) -> None:
    from rich.table import Table

    from ground.air import watch

    rows = await watch(z, seconds)
    if as_json:
        for row in rows:
            click.echo(dump(row))
        return
    table = Table(*COLUMNS)
    for row in rows:
        texts = [row.get(name) for name in COLUMNS.values()]
        table.add_row(*("-" if text in (None, "") else str(text) for text in texts))
    console().print(table if rows else "no traffic is told")


async def _serve(z: Client, settings: TrafficSettings, as_json: bool) -> None:
    from ground.program import until_over
    from ground.traffic.program import TrafficProgram

    settings = msgspec.structs.replace(settings, name=host_name(z, settings.name))
    async with TrafficProgram(z, settings, log) as program:

        def status() -> tuple[str, str, dict[str, Any]]:
            state, text, detail = program.status()
            return state, text, detail | {"traffic": program.listener.rows()}

        await until_over(status, as_json)
