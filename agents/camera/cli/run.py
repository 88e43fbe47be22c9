"""``zmav camera run``: the agent beside the camera."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import click

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.capture import Source
from agents.camera.cli.options import name_option, pair, rate_bytes, triple
from agents.camera.mjpeg import MjpegSource, SimulatedLens, numbers
from agents.camera.settings import Calibration, CameraSettings
from agents.camera.sources import open_source
from zmav.cli.common import fleet_option, run, zenoh_options
from zmav.errors import BadConfig
from zmav.process import leave, say, until_stopped
from zmav.session import SessionSettings

USUAL_FOV = math.radians(63.0)


@click.command("run")
@click.argument("source")
@click.option("--vehicle", required=True, help="The vehicle that the camera is on.")
@name_option
@click.option("--rate", type=click.FloatRange(0.2, 60.0), default=10.0, show_default=True, help="Pictures a second.")
@click.option("--size", callback=pair("640x480"), default="640x480", show_default=True, help="Pixels at most.")
@click.option("--quality", type=click.IntRange(10, 95), default=70, show_default=True, help="Of JPEG.")
@click.option(
    "--budget",
    callback=rate_bytes,
    default="60kB/s",
    show_default=True,
    help="To begin with, and for readers that do not report.",
)
@click.option("--calibration", type=click.Path(path_type=Path), help="A file of the lens's constants: docs/camera.md.")
@click.option("--fov", type=click.FloatRange(3.0, 170.0), metavar="DEG", help="Horizontal field of view instead.")
@click.option("--mount", callback=triple, metavar="R,P,Y", help="Degrees from straight down; 0,90,0 looks ahead.")
@click.option("--offset", callback=triple, metavar="F,R,D", help="Metres forward, right, down of the vehicle.")
@click.option("--gimbal", is_flag=True, help="It is levelled: only the vehicle's heading counts.")
@click.option(
    "--delay",
    type=click.FloatRange(0.0, 5.0),
    default=0.0,
    show_default=True,
    metavar="S",
    help="From shutter to us, where the source does not say when a picture was taken.",
)
@click.option("--loop", is_flag=True, help="A folder begins again at its end.")
@fleet_option
@zenoh_options
def command(
    source: str,
    rate: float,
    delay: float,
    loop: bool,
    calibration: Path | None,
    fov: float | None,
    mount: tuple[float, float, float] | None,
    offset: tuple[float, float, float] | None,
    gimbal: bool,
    size: tuple[int, int],
    fleet: str,
    settings: SessionSettings,
    **rest: Any,
) -> None:
    """Send a camera's pictures: 'zmav camera run 0 --vehicle quad1'.

    SOURCE is a V4L2 device (0, /dev/video0), a URL (rtsp://..., or http://... of multipart JPEG, as the simulator
    serves) or a folder of pictures. Pictures go out while somebody reads them, as many, as large and as
    good as the tightest reader's link takes. SIGTERM ends it.
    """
    if calibration is not None and fov is not None:
        raise BadConfig("give --calibration or --fov, not both", field="fov", value=fov, expected="one of the two")
    opened = open_source(source, rate=rate, loop=loop, delay=delay, size=size)
    found = numbers(opened.words) if isinstance(opened, MjpegSource) else None
    lens = _lens(calibration, fov, found)
    roll, pitch, yaw = (math.radians(angle) for angle in mount or (0.0, 0.0, 0.0))
    given = CameraSettings(
        rate=rate,
        size=size,
        gimbal=gimbal or (found is not None and found.gimbal),
        mount=found.mount if found and mount is None else (roll, pitch, yaw),
        offset=found.offset if found and offset is None else offset or (0.0, 0.0, 0.0),
        **rest,
    ).check()
    run(_run(given, opened, lens, fleet, settings))


def _lens(calibration: Path | None, fov: float | None, found: SimulatedLens | None) -> Calibration | float:
    if calibration is not None:
        return Calibration.load(calibration)
    if fov is not None:
        return math.radians(fov)
    if found is not None:
        return found.calibration
    say(f"no --calibration and no --fov: the lens is taken for {math.degrees(USUAL_FOV):.0f}° wide, without distortion")
    return USUAL_FOV


async def _run(
    own: CameraSettings, source: Source, lens: Calibration | float, fleet: str, settings: SessionSettings
) -> None:
    async with (
        zmav.open(fleet=fleet, settings=settings) as z,
        CameraAgent(z, own, source, lens, settings, say) as agent,
    ):
        say(f"{fleet}/{own.vehicle}/{own.camera}: {source.words}, {own.budget / 1e3:.0f} kB/s to begin with")
        stopped, finished = (asyncio.ensure_future(each) for each in (until_stopped(), agent.finished()))
        done, _ = await asyncio.wait({stopped, finished}, return_when=asyncio.FIRST_COMPLETED)
        stopped.cancel()
        for each in done:
            each.result()
    say(f"{agent.sent} pictures sent")
    leave()
