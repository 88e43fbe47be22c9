"""``zmav gcs``."""

from __future__ import annotations

import click

from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Endpoint, Kind, Options, parse_endpoint, read_rate, read_vehicles
from zmav import keys
from zmav.cli.common import Work, connected, dialect_option
from zmav.client import Client
from zmav.errors import Forbidden
from zmav.links.sockets import is_loopback
from zmav.process import say, until_stopped

DEFAULT = "14550"
"""where QGroundControl and Mission Planner wait"""


@click.command("gcs")
@click.option(
    "--udp", multiple=True, metavar="[HOST:]PORT", help="Send to a station that waits there.  [default: 14550]"
)
@click.option("--udpin", multiple=True, metavar="[HOST:]PORT", help="Wait there for any number of stations.")
@click.option("--tcp", multiple=True, metavar="[HOST:]PORT", help="Wait there for connections of stations.")
@click.option("--serial", multiple=True, metavar="DEV[,BAUD]", help="A radio or a cable to a station.")
@click.option("--vehicles", default="*", show_default=True, help="Which, by name: 'quad*,rover1'.")
@click.option("--rate", help="Bytes a second to each station: '4kB/s'.")
@click.option("--read-only", is_flag=True, help="Nothing a station says reaches a vehicle.")
@click.option("--streams/--no-streams", default=True, show_default=True, help="Ask vehicles for what stations need.")
@dialect_option
@connected
def command(
    udp: tuple[str, ...],
    udpin: tuple[str, ...],
    tcp: tuple[str, ...],
    serial: tuple[str, ...],
    vehicles: str,
    rate: str | None,
    read_only: bool,
    streams: bool,
) -> Work:
    """Connect QGroundControl, Mission Planner, MAVProxy or any MAVLink program to the whole fleet.

    Without an endpoint, vehicles appear in a QGroundControl on this machine by themselves. An endpoint may have options
    of its own: --tcp '0.0.0.0:5760?rate=4kB/s&vehicles=quad*&read_only=1'.
    Only a HOST that is written out listens to other machines, and anyone who reaches it may command the vehicles.
    """
    defaults = Options(
        rate=read_rate(rate) if rate is not None else None,
        read_only=read_only,
    )
    given = {"udp": udp, "udpin": udpin, "tcp": tcp, "serial": serial}
    bridge = BridgeSettings(endpoints=endpoints(given, defaults), vehicles=read_vehicles(vehicles), streams=streams)
    return lambda z: _bridge(z, bridge)


def endpoints(given: dict[str, tuple[str, ...]], defaults: Options) -> tuple[Endpoint, ...]:
    """What the options name; QGroundControl's own port where they name nothing."""
    kinds: tuple[Kind, ...] = ("udp", "udpin", "tcp", "serial")
    found = [parse_endpoint(kind, text, defaults) for kind in kinds for text in given[kind]]
    return tuple(found) or (parse_endpoint("udp", DEFAULT, defaults),)


async def _bridge(z: Client, settings: BridgeSettings) -> None:
    settings = allowed(z, settings)
    async with Bridge(z, settings, say):
        for endpoint in settings.endpoints:
            say(_words(endpoint))
        await until_stopped()


def allowed(z: Client, settings: BridgeSettings) -> BridgeSettings:
    """The settings, read-only where our credentials are a viewer's: routers would drop what stations send, unsaid."""
    if keys.is_replay(z.fleet_name):
        say(f"read-only: {z.fleet_name} is of recordings, which take no orders")
        return settings.read_only()
    if z.member is None:
        return settings
    try:
        z.member.check_role(keys.TX.key(z.member.credentials.fleet, "vehicles", sys=0, comp=0, msg="HEARTBEAT"))
    except Forbidden as e:
        say(f"read-only, by your credentials: {e}")
        return settings.read_only()
    return settings


def _words(endpoint: Endpoint) -> str:
    does = "sending to" if endpoint.kind == "udp" else "on" if endpoint.kind == "serial" else "waiting for stations at"
    where = endpoint.text if endpoint.kind == "serial" else endpoint.where
    options = endpoint.options
    far = endpoint.kind in ("udpin", "tcp") and not (endpoint.host == "localhost" or is_loopback(endpoint.host))
    notes = [
        f"{options.rate:g} B/s" if options.rate else "",
        f"vehicles {','.join(options.vehicles)}" if options.vehicles != ("*",) else "",
        "read-only" if options.read_only else "anyone who reaches it may command the vehicles" if far else "",
    ]
    said = "; ".join(filter(None, notes))
    return f"{endpoint.kind}: {does} {where}" + (f" ({said})" if said else "")
