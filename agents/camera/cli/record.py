"""``zmav camera record``: pictures to a disk."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import click

import zmav
from agents.camera.cli.options import Line, amount, name_option
from agents.camera.recorder import Recorder
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import VehicleError
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.vision.reader import Reader, camera_info

USUAL_RATE = 10.0


@click.command("record")
@click.argument("vehicle")
@click.argument("target", type=click.Path(path_type=Path), metavar="FILE.avi|FOLDER")
@name_option
@click.option(
    "--keep-free", callback=amount, default="1GB", show_default=True, help="Write nothing while less is free."
)
@fleet_option
@zenoh_options
def command(vehicle: str, target: Path, camera: str, keep_free: float, fleet: str, settings: SessionSettings) -> None:
    """Record a camera's pictures as they came: JPEGs in a folder, or one .avi; and a .csv of when each was taken.

    What was written stays whole whatever ends the recorder; of an .avi the last second may be missing. It plays at the
    pictures' mean rate; the true times are in the .csv. Pictures of another size are fitted to the first one's.
    """
    run(_record(vehicle, target, camera, keep_free, fleet, settings))


async def _record(
    vehicle: str, target: Path, camera: str, keep_free: float, fleet: str, settings: SessionSettings
) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z, Reader(z, vehicle, camera, name="record") as pictures:
        try:
            rate = (await camera_info(z, vehicle, camera)).rate_hz
        except VehicleError as e:
            say(f"{e}; waiting for it")
            rate = USUAL_RATE
        recorder = Recorder(target, rate, keep_free)
        say(f"recording {fleet}/{vehicle}/{camera} to {target}")
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
    say(f"{recorder.written} pictures, {recorder.bytes / 1e6:.1f} MB{lost}: {target}")


async def _write(pictures: Reader, recorder: Recorder) -> None:
    async for picture in pictures:
        await asyncio.shield(asyncio.to_thread(recorder.add, picture))


async def _tell(pictures: Reader, recorder: Recorder) -> None:
    line, start = Line(), time.monotonic()
    try:
        while True:
            await asyncio.sleep(1.0)
            passed = time.strftime("%H:%M:%S", time.gmtime(time.monotonic() - start))
            counts = f"{recorder.written} pictures, {recorder.bytes / 1e6:.1f} MB, {pictures.assembler.torn} torn"
            line.show(f"{passed}  {counts}" + (f"  {recorder.full}" if recorder.full else ""))
    finally:
        line.end()
