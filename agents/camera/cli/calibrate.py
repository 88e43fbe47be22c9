"""``zmav camera calibrate``: a lens's numbers from views of a chessboard."""

from __future__ import annotations

from pathlib import Path

import click

from agents.camera.calibrate import Views, from_folder
from agents.camera.cli.options import pair


@click.command("calibrate")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
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
def command(folder: Path, squares: tuple[int, int], side: float, out: Path) -> None:
    """Work out a camera's lens from a chessboard: 'zmav camera calibrate views --squares 9x6 --size 0.025 -o a.toml'.

    FOLDER has pictures of the board, as 'zmav camera record' writes them, whole and sharp, from ten sides or more:
    tilted to and fro and to the sides, near the corners of the picture, too. 'zmav camera run --calibration FILE' reads
    the file.
    """
    views = Views(squares, side)
    for name, why in from_folder(folder, views):
        click.echo(f"{name}: {why or 'taken'}")
    result = views.solve()
    found = result.calibration
    found.save(out)
    (fx, fy), (cx, cy) = found.focal, found.center
    click.echo(
        f"{out}: {found.views} views, corners off by {result.error_px:.3f} px (root mean square); focal length "
        f"{fx:.1f}, {fy:.1f} px (±{result.focal_sigma:.1f}), centre {cx:.1f}, {cy:.1f}"
    )
