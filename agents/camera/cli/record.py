"""``zmav camera record``: pictures to a disk."""

from __future__ import annotations

import asyncio
import shutil
import time
from pathlib import Path
from typing import IO

import click

import zmav
from agents.camera.cli.options import name_option
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import BadConfig
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.vision.reader import Picture, Reader

COLUMNS = "file,seq,t,arrived,width,height\n"
TOLD_EVERY = 1.0
"""s between two lines that say how it goes, and two looks at how much room is left"""
KEEP_FREE = 1e9
"""bytes that are left free on the disk"""


class Recorder:
    """Writes JPEGs to ``folder`` as they came, and a table beside them, each line of which names a whole picture.

    Raises :class:`BadConfig` where nobody may write, or a recording is there already. Where less than ``keep_free``
    bytes are free, :attr:`full` says so and pictures are counted as ``unwritten``.
    """

    def __init__(self, folder: Path, keep_free: float = KEEP_FREE) -> None:
        self.written = self.unwritten = self.bytes = 0
        self.full = ""
        """why nothing is written at present"""
        self._folder, self._keep_free, self._looked = folder, keep_free, -TOLD_EVERY
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
        if now - self._looked >= TOLD_EVERY:
            self._looked = now
            free = shutil.disk_usage(self._folder).free
            self.full = "" if free > self._keep_free else f"{free / 1e6:.0f} MB are free: nothing is written"
        return not self.full


@click.command("record")
@click.argument("vehicle")
@click.argument("folder", type=click.Path(path_type=Path))
@name_option
@fleet_option
@zenoh_options
def command(vehicle: str, folder: Path, camera: str, fleet: str, settings: SessionSettings) -> None:
    """Record a camera's pictures as they came: JPEGs in a folder, and a .csv of when each was taken.

    What was written stays whole whatever ends the recorder. Nothing is written while less than 1 GB is free.
    """
    run(_record(vehicle, folder, camera, fleet, settings))


async def _record(vehicle: str, folder: Path, camera: str, fleet: str, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z, Reader(z, vehicle, camera, name="record") as pictures:
        recorder = Recorder(folder)
        say(f"recording {fleet}/{vehicle}/{camera} to {folder}")
        tasks = [asyncio.create_task(_write(pictures, recorder)), asyncio.create_task(_tell(pictures, recorder))]
        stopped = asyncio.create_task(until_stopped())
        try:
            done, _ = await asyncio.wait({*tasks, stopped}, return_when=asyncio.FIRST_COMPLETED)
            for each in done:
                each.result()
        finally:
            for each in (*tasks, stopped):
                each.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            recorder.close()
    lost = f", {recorder.unwritten} without room ({recorder.full})" if recorder.unwritten else ""
    say(f"{recorder.written} pictures, {recorder.bytes / 1e6:.1f} MB{lost}: {folder}")


async def _write(pictures: Reader, recorder: Recorder) -> None:
    async for picture in pictures:
        await asyncio.shield(asyncio.to_thread(recorder.add, picture))


async def _tell(pictures: Reader, recorder: Recorder) -> None:
    while True:
        await asyncio.sleep(TOLD_EVERY)
        counts = f"{recorder.written} pictures, {recorder.bytes / 1e6:.1f} MB, {pictures.assembler.torn} torn"
        click.echo(counts + (f"  {recorder.full}" if recorder.full else ""))
