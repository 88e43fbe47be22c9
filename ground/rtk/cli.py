"""``zmav rtk``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click
import msgspec

from ground.host import host_name
from ground.rtk.options import Fixed, parse_place, parse_source, parse_survey
from zmav import keys
from zmav.cli.common import Work, connected, json_option
from zmav.client import Client
from zmav.errors import BadInput, needs
from zmav.process import log

if TYPE_CHECKING:
    from ground.rtk.program import RtkSettings


@click.command("rtk")
@click.argument("source")
@click.option(
    "--gga", metavar="WHO", help="Tell the caster where this vehicle is, or LAT,LON,ALT: for its virtual base."
)
@click.option("--survey", metavar="SECONDS,METRES", help="Have a u-blox receiver survey itself in: '120,1.5'.")
@click.option(
    "--at", metavar="LAT,LON,HEIGHT", help="Tell a u-blox receiver where its antenna is; above the ellipsoid."
)
@click.option(
    "--port", type=click.Choice(["USB", "UART1", "UART2"]), help="The receiver's own port.  [default: USB or UART1]"
)
@click.option(
    "--priority",
    type=click.IntRange(0, 255),
    default=0,
    show_default=True,
    help="Of several sources the highest is in charge.",
)
@click.option("--name", help="Name of this host.  [default: the credentials', or ground]")
@json_option
@connected
def command(
    source: str,
    gga: str | None,
    survey: str | None,
    at: str | None,
    port: str | None,
    priority: int,
    name: str | None,
    as_json: bool,
) -> Work:
    """Send corrections to the GNSS receivers of the whole fleet, each radio crossed once.

    SOURCE is an NTRIP caster (ntrip://USER@HOST:2101/MOUNTPOINT, ntrips:// with TLS; the password from
    $ZMAV_NTRIP_PASSWORD), a base receiver (/dev/ttyACM0, /dev/ttyUSB0,115200, tcp:HOST:PORT), or a file of RTCM 3.
    A second source stands by. 'zmav top', the page and 'zmav doctor' show what comes of it at each vehicle.
    """
    needs("'zmav rtk'", "rtk", "pygnssutils", "pyubx2")
    from ground.rtk.program import RtkSettings, check

    if survey and at:
        raise BadInput("--survey or --at, not both", field="at", value=at, expected="one of them")
    rover: str | Fixed | None = None
    if gga:
        rover = parse_place(gga, "gga") if "," in gga else keys.check_name(gga, "gga")
    settings = RtkSettings(
        where=parse_source(source),
        name=name or "",
        priority=priority,
        rover=rover,
        base=parse_survey(survey) if survey else parse_place(at) if at else None,
        port=port,
    )
    check(settings)
    return lambda z: _serve(z, settings, as_json)


async def _serve(z: Client, settings: RtkSettings, as_json: bool) -> None:
    from ground.program import until_over
    from ground.rtk.program import Rtk

    async with Rtk(z, msgspec.structs.replace(settings, name=host_name(z, settings.name)), log) as rtk:
        await until_over(rtk.status, as_json, rtk.run())
