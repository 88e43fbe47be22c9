"""``zmav camera view``: what comes of a camera's pictures here, and one of them."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import click

import zmav
from agents.camera.cli.options import name_option, rate_bytes
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import BadConfig, TimedOut
from zmav.session import SessionSettings
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.waiting import together, within


@click.command("view")
@click.argument("vehicle")
@name_option
@click.option(
    "--save",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.jpg",
    help="Write the newest picture and end.",
)
@click.option(
    "--wait", type=click.FloatRange(0.1), default=10.0, show_default=True, help="Seconds for a first picture."
)
@click.option(
    "--link",
    callback=lambda c, o, v: None if v is None else rate_bytes(c, o, v),
    metavar="RATE",
    help="What our link has for pictures, as 60kB/s.  [default: the camera finds out]",
)
@fleet_option
@zenoh_options
def command(
    vehicle: str, camera: str, save: Path | None, wait: float, link: float | None, fleet: str, settings: SessionSettings
) -> None:
    """Show what comes of a camera each second: rate, delay, size, loss. 'zmav view' shows the pictures themselves.

    The delay is from shutter to here, by both computers' clocks.
    """

    async def view() -> None:
        async with (
            zmav.open(fleet=fleet, settings=settings) as z,
            Reader(z, vehicle, camera, name="view", most_bytes=link) as pictures,
        ):
            try:
                first = await within(wait, pictures.get())
            except asyncio.TimeoutError:
                await camera_info(z, vehicle, camera)  # raises where there is no such camera
                text = f"{vehicle}/{camera} is there, but sent no whole picture within {wait:g} s"
                raise TimedOut(text, vehicle=vehicle) from None
            if save is not None:
                _save(save, first)
                return
            since = [first]
            await together(_take(pictures, since), _tell(pictures, since))

    run(view())


def _save(path: Path, picture: Picture) -> None:
    try:
        path.write_bytes(picture.jpeg)
    except OSError as e:
        text = f"cannot write {path}: {e.strerror}"
        raise BadConfig(text, field="save", value=str(path), expected="a file that can be written") from e
    age = picture.arrived - picture.t
    click.echo(f"{path}: {picture.width}x{picture.height}, {len(picture.jpeg)} B, taken {age:.2f} s before it came")


async def _take(pictures: Reader, since: list[Picture]) -> None:
    async for picture in pictures:
        since.append(picture)


async def _tell(pictures: Reader, since: list[Picture]) -> None:
    """Of what came ``since`` the last line."""
    start, torn = time.monotonic(), 0
    while True:
        await asyncio.sleep(1.0)
        now = time.monotonic()
        click.echo(f"{_words(since, now - start)}{pictures.assembler.torn - torn} torn")
        start, torn = now, pictures.assembler.torn
        since.clear()


def _words(came: list[Picture], seconds: float) -> str:
    if not came:
        return "no picture, "
    delay = sorted(picture.arrived - picture.t for picture in came)[len(came) // 2]
    size = sum(len(picture.jpeg) for picture in came)
    return (
        f"{came[-1].width}x{came[-1].height}  {len(came) / seconds:.1f} Hz  {1e3 * delay:.0f} ms  "
        f"{size / len(came) / 1e3:.1f} kB a picture  {size / seconds / 1e3:.0f} kB/s  "
    )
