"""``zmav tak``."""

from __future__ import annotations

import re

import click
import msgspec

from ground.host import host_name
from zmav import keys
from zmav.cli.common import Between, Work, connected, json_option
from zmav.client import Client
from zmav.errors import BadUrl, needs
from zmav.process import log

EXPECTED = "tcp://HOST:8087, tls://HOST:8089, or udp://239.2.3.1:6969"


@click.command("tak")
@click.argument("url")
@click.option("--cert", metavar="FILE", help="Our certificate for TLS; its password in $PYTAK_TLS_CLIENT_PASSWORD.")
@click.option("--key", metavar="FILE", help="Its key, where that is a file of its own.")
@click.option("--ca", metavar="FILE", help="Who signs the server's certificate.  [default: the system's authorities]")
@click.option("--every", type=Between(0.2, 60.0), default=1.0, show_default=True, help="Seconds between two positions.")
@click.option(
    "--geoid",
    type=Between(-110.0, 90.0),
    help="Metres of the geoid above the ellipsoid there: heights are above the ellipsoid then.",
)
@click.option("--name", help="Name of this host.  [default: the credentials', or ground]")
@json_option
@connected
def command(
    url: str,
    cert: str | None,
    key: str | None,
    ca: str | None,
    every: float,
    geoid: float | None,
    name: str | None,
    as_json: bool,
) -> Work:
    """Show the fleet on ATAK, WinTAK and others: cursor on target to a TAK server, or by multicast.

    Every vehicle with its course, speed and height, an emergency where something is bad, and the ways and goals of
    what the planner flies. URL: tcp://HOST:8087, tls://HOST:8089, udp://239.2.3.1:6969. It connects again by itself.
    Nothing that comes from there is obeyed.
    """
    found = re.fullmatch(r"(tcp|tls|udp)://(\[[0-9a-fA-F:.]+\]|[\w.-]+):(\d{1,5})", url)
    if found is None or not 0 < int(found[3]) < 65536:
        raise BadUrl(f"no TAK server {url!r}", field="url", value=url, expected=EXPECTED)
    needs("'zmav tak'", "traffic", "pytak")
    from ground.tak.program import TakSettings, tls_of

    settings = TakSettings(
        url=url.replace("udp://", "udp+wo://"),
        name=keys.check_name(name) if name else "",
        every=every,
        geoid=geoid,
        tls=tls_of(cert, key, ca) if url.startswith("tls:") else {},
    )

    async def serve(z: Client) -> None:
        from ground.program import until_over
        from ground.tak.program import Tak

        async with Tak(z, msgspec.structs.replace(settings, name=host_name(z, settings.name)), log) as tak:
            await until_over(tak.status, as_json)

    return serve
