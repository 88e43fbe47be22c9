"""``zmav http``."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zmav import keys
from zmav.cli import places
from zmav.cli.common import amount, dialect_option, fleet_option, run, zenoh_options
from zmav.errors import BadConfig, needs
from zmav.links.sockets import is_loopback
from zmav.onboard import OnboardSettings
from zmav.process import say, until_stopped
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from ground.http.gateway import Gateway
    from ground.http.guard import Rules
    from ground.record.sources import Source

VARIABLE = "ZMAV_HTTP_TOKEN"


def edges(text: str) -> tuple[float, float, float, float]:
    """``S,W,N,E`` in degrees."""
    south, west, north, east = places.numbers(text, 4, "S,W,N,E: degrees, as -35.37,149.15,-35.36,149.17")
    return (south, west, north, east)


@click.command("http")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; beyond loopback: a token.")
@click.option("--port", type=click.IntRange(0, 65535), default=8088, show_default=True, help="TCP port; 0: a free one.")
@click.option(
    "--token",
    envvar=VARIABLE,
    show_envvar=True,
    default="",
    help="What every request has to bring along; others see it in the list of processes.",
)
@click.option("--token-file", type=click.Path(dir_okay=False), help="The file whose first line is the token.")
@click.option("--read-only", is_flag=True, help="Refuse whatever writes to vehicles.")
@click.option("--allow-host", multiple=True, metavar="NAME", help="A name under which it is reached (repeatable).")
@click.option("--allow-origin", multiple=True, metavar="URL", help="A site whose pages may ask, too (repeatable).")
@click.option("--tiles", type=click.Path(dir_okay=False), help="Pictures of the ground: FILE.pmtiles or FILE.mbtiles.")
@click.option(
    "--replay",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Play recordings as 'zmav replay' does, with a timeline on the page, which only reads (repeatable).",
)
@click.option("--tile-server", metavar="URL", help="Pictures of the ground from https://HOST/{z}/{x}/{y}.png, kept.")
@click.option(
    "--tile-cache",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("~/.cache/zmav/tiles"),
    show_default=True,
    help="Folder in which those are kept.",
)
@click.option("--tile-space", callback=amount, default="500MB", show_default=True, help="So much of them at most.")
@click.option("--picture", type=click.Path(dir_okay=False, path_type=Path), help="A picture or GeoTIFF over the map.")
@click.option("--corners", type=edges, metavar="S,W,N,E", help="Where a picture lies, in degrees; a GeoTIFF says it.")
@dialect_option
@fleet_option
@zenoh_options
def command(
    host: str,
    port: int,
    token: str,
    token_file: str | None,
    read_only: bool,
    allow_host: tuple[str, ...],
    allow_origin: tuple[str, ...],
    tiles: str | None,
    replay: tuple[Path, ...],
    tile_server: str | None,
    tile_cache: Path,
    tile_space: int,
    picture: Path | None,
    corners: tuple[float, float, float, float] | None,
    dialect: str,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Serve the fleet over HTTP and WebSocket: for MATLAB, browsers, mavlink2rest's clients and Prometheus.

    'curl localhost:8088/vehicles' says who is there, 'curl localhost:8088/last/1/1/ATTITUDE' a message,
    'curl localhost:8088/keys/quad1' anything in the key space; a browser finds a page at http://localhost:8088/.
    """
    if tiles and tile_server:
        raise click.UsageError("give one of --tiles and --tile-server")
    located = picture is not None and picture.suffix.lower() in (".tif", ".tiff")
    if (picture is None) != (corners is None) and not located:
        raise click.UsageError("a picture lies somewhere: give --picture and --corners")
    secret = _read_token(token_file) if token_file else token
    if host != "localhost" and not is_loopback(host) and not secret:
        text = (
            f"--host {host} would let anybody in reach fly the fleet: give a token, in ${VARIABLE} or by --token-file "
            f"(others see --token in the list of processes), or listen on 127.0.0.1"
        )
        raise BadConfig(text, field="token", value="", expected="a token")
    needs("'zmav http'", "ground", "uvicorn", "websockets", "starlette.applications")
    from ground.http.gateway import Gateway
    from ground.http.guard import LOOPBACK, Rules
    from ground.http.server import bound
    from ground.http.tiles import Picture, Tiles
    from ground.http.tileserver import TileServer

    hosts = {*LOOPBACK, host.lower(), *(name.lower() for name in allow_host)}
    origins = frozenset(each.rstrip("/").lower() for each in allow_origin)
    rules = Rules(token=secret, read_only=read_only or bool(replay), hosts=hosts, origins=origins)
    sock = bound(host, port)
    over = Picture(picture, corners) if picture is not None else None
    ground: Tiles | TileServer | None = Tiles(Path(tiles)) if tiles else None
    if tile_server:
        ground = TileServer(tile_server, tile_cache.expanduser(), tile_space)
    sources: list[Source] = []
    if replay:
        from ground.record.sources import open_all

        sources = open_all(replay)
    fleet = keys.replay_of(keys.check_name(fleet, "fleet")) if sources else fleet
    base = OnboardSettings(link="", name="replay", fleet=fleet, dialect=dialect)

    async def meet() -> None:
        from zmav.client import connect

        async with connect(fleet=fleet, settings=settings, dialect=dialect) as z, contextlib.AsyncExitStack() as stack:
            player = None
            if sources:
                from ground.record.steering import steered

                player = await stack.enter_async_context(steered(z, sources, base))
            await _serve(host, sock, rules, Gateway(z, rules.read_only, tiles=ground, picture=over, player=player))

    run(meet())


async def _serve(host: str, sock: socket.socket, rules: Rules, made: Gateway) -> None:
    from ground.http.app import make_app
    from ground.http.server import serving

    async with (
        made as gateway,
        serving(make_app(gateway, rules), sock) as port,
    ):
        shown = f"[{host}]" if ":" in host else host
        how = "".join((", with a token" if rules.token else "", ", only reading" if rules.read_only else ""))
        say(f"fleet {gateway.client.fleet_name} at http://{shown}:{port}/{how}")
        await until_stopped()


def _read_token(path: str) -> str:
    """Raises :class:`BadConfig` where the file cannot be read or holds none."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        why = e.strerror if isinstance(e, OSError) else e
        raise BadConfig(f"token file {path}: {why}", field="token_file", value=path, expected="a text file") from e
    if not lines or not lines[0].strip():
        raise BadConfig(f"token file {path} is empty", field="token_file", value=path, expected="a token")
    return lines[0].strip()
