"""``zmav camera view``: what comes of a camera's pictures here, and the pictures on a disk."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import time
from pathlib import Path
from typing import IO

import click

import zmav
from agents.camera.cli.options import name_option, rate_bytes
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import BadConfig, TimedOut
from zmav.session import SessionSettings
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.waiting import together, within

COLUMNS = "file,seq,t,arrived,width,height\n"
LOOK_EVERY = 1.0
"""s between two looks at how much room is left"""
KEEP_FREE = 1e9
"""bytes that are left free on the disk"""


class PictureRecorder:
    """Writes JPEGs to ``folder`` as they came, and a table beside them, each line of which names a whole picture.

    Raises :class:`BadConfig` where nobody may write, or a recording is there already. Where less than ``keep_free``
    bytes are free, :attr:`full` says so and pictures are counted as ``unwritten``.
    """

    def __init__(self, folder: Path, keep_free: float = KEEP_FREE) -> None:
        self.written = self.unwritten = self.bytes = 0
        self.full = ""
        """why nothing is written at present"""
        self._folder, self._keep_free, self._looked = folder, keep_free, -LOOK_EVERY
        table = folder / "pictures.csv"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if table.exists():
                text = f"{table} is there already: name another folder"
                raise BadConfig(text, field="folder", value=str(folder), expected="a new folder")
            self._table: IO[str] = table.open("x", encoding="ascii")
            self._table.write(COLUMNS)
            self._table.flush()
        except OSError as e:
            text = f"cannot write to {folder}: {e.strerror}"
            raise BadConfig(text, field="folder", value=str(folder), expected="a place to write to") from e

    def add(self, p: Picture) -> bool:
        """Write a picture; False where it was not."""
        if not self._room():
            self.unwritten += 1
            return False
        name = f"{self.written:08d}.jpg"
        try:
            part = self._folder / f"{name}.part"
            part.write_bytes(p.jpeg)
            part.replace(self._folder / name)  # anyone who is killed meanwhile leaves no torn picture
            self._table.write(f"{name},{p.seq},{p.t:.6f},{p.arrived:.6f},{p.width},{p.height}\n")
            self._table.flush()
        except OSError as e:
            self.full, self.unwritten = str(e), self.unwritten + 1
            return False
        self.written += 1
        self.bytes += len(p.jpeg)
        return True

    def close(self) -> None:
        self._table.close()

    def _room(self) -> bool:
        now = time.monotonic()
        if now - self._looked >= LOOK_EVERY:
            self._looked = now
            free = shutil.disk_usage(self._folder).free
            self.full = "" if free > self._keep_free else f"{free / 1e6:.0f} MB are free: nothing is written"
        return not self.full


@click.command("view")
@click.argument("vehicle")
@name_option
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Write all pictures as they come, and a .csv of when each was taken.",
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
    vehicle: str,
    camera: str,
    record: Path | None,
    wait: float,
    link: float | None,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Show what comes of a camera each second: rate, delay, size, loss. 'zmav view' shows the pictures themselves.

    The delay is from shutter to here, by both computers' clocks. What --record has written stays whole whatever ends
    it; nothing is written while less than 1 GB is free.
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
            with contextlib.closing(PictureRecorder(record)) if record else contextlib.nullcontext() as recorder:
                since = [first]
                await together(_take(pictures, since, recorder), _tell(pictures, since, recorder))

    run(view())


async def _take(pictures: Reader, since: list[Picture], recorder: PictureRecorder | None) -> None:
    """The first one came already."""
    (picture,) = since
    while True:
        if recorder is not None:
            await asyncio.shield(asyncio.to_thread(recorder.add, picture))
        picture = await pictures.get()
        since.append(picture)


async def _tell(pictures: Reader, since: list[Picture], recorder: PictureRecorder | None) -> None:
    """Of what came ``since`` the last line."""
    start, torn = time.monotonic(), 0
    while True:
        await asyncio.sleep(1.0)
        now = time.monotonic()
        kept = f"  {recorder.written} written {recorder.full}".rstrip() if recorder else ""
        click.echo(f"{_words(since, now - start)}{pictures.assembler.torn - torn} torn{kept}")
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
