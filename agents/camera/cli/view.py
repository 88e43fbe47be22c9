"""``zmav camera view``: what comes of a camera's pictures here, and one of them, or all for a browser."""

from __future__ import annotations

import asyncio
import contextlib
import time
from pathlib import Path

import click

import zmav
from agents.camera.cli.options import Line, name_option, rate_bytes, words
from agents.camera.webserver import WebServer
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
@click.option("--serve", type=click.IntRange(0, 65535), metavar="PORT", help="For a browser on this computer; 0: any.")
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
    vehicle: str,
    camera: str,
    save: Path | None,
    serve: int | None,
    wait: float,
    link: float | None,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Show what comes of a camera: rate, delay, size, loss; 'zmav camera view quad1 --serve 8080' shows the pictures.

    The delay is from shutter to here, by both computers' clocks.
    """

    async def view() -> None:
        async with contextlib.AsyncExitStack() as stack:
            z = await stack.enter_async_context(zmav.open(fleet=fleet, settings=settings))
            reader = Reader(z, vehicle, camera, name="view", most_bytes=link)
            pictures = await stack.enter_async_context(reader)
            try:
                first = await within(wait, pictures.get())
            except asyncio.TimeoutError:
                await camera_info(z, vehicle, camera)  # raises where there is no such camera
                text = f"{vehicle}/{camera} is there, but sent no whole picture within {wait:g} s"
                raise TimedOut(text, vehicle=vehicle) from None
            if save is not None:
                _save(save, first)
                return
            server = None
            if serve is not None:
                server = await stack.enter_async_context(WebServer(serve))
                click.echo(f"pictures are at {server.url}")
            shown = _Shown(pictures, server)
            await together(shown.take(first), shown.tell())

    run(view())


def _save(path: Path, picture: Picture) -> None:
    try:
        path.write_bytes(picture.jpeg)
    except OSError as e:
        text = f"cannot write {path}: {e.strerror}"
        raise BadConfig(text, field="save", value=str(path), expected="a file that can be written") from e
    age = picture.arrived - picture.t
    click.echo(f"{path}: {picture.width}x{picture.height}, {len(picture.jpeg)} B, taken {age:.2f} s before it came")


class _Shown:
    """Counts what comes, and passes it on."""

    def __init__(self, pictures: Reader, server: WebServer | None) -> None:
        self._pictures, self._server = pictures, server
        self._last: Picture | None = None
        self._since: list[Picture] = []

    async def take(self, first: Picture) -> None:
        picture = first
        while True:
            self._since.append(picture)
            self._last = picture
            if self._server is not None:
                await self._server.show(picture)
            picture = await self._pictures.get()

    async def tell(self) -> None:
        line, start, torn = Line(), time.monotonic(), 0
        try:
            while True:
                await asyncio.sleep(1.0)
                line.show(self._words(time.monotonic() - start, self._pictures.assembler.torn - torn))
                start, torn = time.monotonic(), self._pictures.assembler.torn
                self._since.clear()
        finally:
            line.end()

    def _words(self, seconds: float, torn: int) -> str:
        came = self._since
        if not came or self._last is None:
            return f"no picture, {torn} torn"
        delay = sorted(picture.arrived - picture.t for picture in came)[len(came) // 2]
        size = sum(len(picture.jpeg) for picture in came)
        return (
            f"{self._last.width}x{self._last.height}  {len(came) / seconds:.1f} Hz  {words(1e3 * delay, 'ms')}  "
            f"{size / len(came) / 1e3:.1f} kB a picture  {size / seconds / 1e3:.0f} kB/s  {torn} torn"
        )
