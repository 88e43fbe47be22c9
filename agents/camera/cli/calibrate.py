"""``zmav camera calibrate``: a lens's numbers from views of a chessboard."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import click

import zmav
from agents.camera.calibrate import MOST, Views, from_folder
from agents.camera.cli.options import name_option, pair
from agents.camera.settings import Calibration
from zmav import keys
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import BadConfig, BadInput, BadKey
from zmav.session import SessionSettings
from zmav.vision.reader import Reader
from zmav.waiting import within


@click.command("calibrate")
@click.argument("source", metavar="FOLDER|VEHICLE")
@click.option(
    "--squares",
    callback=pair("9x6"),
    required=True,
    metavar="AxB",
    help="Squares of the board as printed (inner corners are one less each way).",
)
@click.option(
    "--size",
    "side",
    type=click.FloatRange(0.0, 10.0, min_open=True),
    required=True,
    metavar="M",
    help="Side of a square, metres.",
)
@click.option("-o", "--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="Where to write it.")
@name_option
@click.option(
    "--for",
    "seconds",
    type=click.FloatRange(1.0),
    default=60.0,
    show_default=True,
    help="Seconds to watch a vehicle's camera at most.",
)
@fleet_option
@zenoh_options
def command(
    source: str,
    squares: tuple[int, int],
    side: float,
    out: Path,
    camera: str,
    seconds: float,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Work out a camera's lens from a chessboard: 'zmav camera calibrate views --squares 9x6 --size 0.025 -o a.toml'.

    Show the board whole and sharp, from ten sides or more: tilted to and fro and to the sides, near the corners of the
    picture, too. A vehicle's camera must send full-size pictures meanwhile. 'zmav camera run --calibration FILE' reads
    the file.
    """
    views = Views(squares, side)
    folder = Path(source)
    if folder.is_dir():
        for name, why in from_folder(folder, views):
            click.echo(f"{name}: {why or 'taken'}")
        _finish(views, out)
        return
    try:
        keys.check_name(source, "vehicle")
    except BadKey:
        text = f"{source!r} is neither a folder nor a vehicle's name"
        raise BadConfig(text, field="source", value=source, expected="a folder, or a vehicle") from None
    run(_watch(source, camera, seconds, views, fleet, settings))
    _finish(views, out)


def _finish(views: Views, out: Path) -> None:
    result = views.solve()
    found: Calibration = result.calibration
    found.save(out)
    (fx, fy), (cx, cy) = found.focal, found.center
    click.echo(
        f"{out}: {found.views} views, corners off by {result.error_px:.3f} px (root mean square); focal length "
        f"{fx:.1f}, {fy:.1f} px (±{result.focal_sigma:.1f}), centre {cx:.1f}, {cy:.1f}"
    )


async def _watch(
    vehicle: str, camera: str, seconds: float, views: Views, fleet: str, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z, Reader(z, vehicle, camera, name="calibrate") as pictures:
        until, said = time.monotonic() + seconds, ""
        while len(views.corners) < MOST:
            try:
                picture = await within(until - time.monotonic(), pictures.get())
                why = await asyncio.to_thread(lambda: views.add(picture.decode()))  # noqa: B023 - awaited at once
            except asyncio.TimeoutError:
                return
            except BadInput as e:
                why = str(e)
            if not why or why != said:
                click.echo(f"{len(views.corners)} views" + (f"; this one: {why}" if why else ""))
            said = why
