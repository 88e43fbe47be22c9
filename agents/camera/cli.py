"""``zmav camera run|view``: the agent beside the camera; what comes of its pictures elsewhere, and on a disk."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import shutil
import time
from pathlib import Path
from typing import IO, Any

import click

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.capture import Source
from agents.camera.mjpeg import MjpegSource, SimulatedLens, numbers
from agents.camera.photos import PREFIX, Photos
from agents.camera.settings import MOST_ZOOM, Calibration, CameraSettings
from agents.camera.sources import open_source
from zmav.cli import places
from zmav.cli.common import Between, Work, connected, dump, json_option
from zmav.cli.vehicles import matching
from zmav.config.mesh import bits_per_second
from zmav.errors import BadConfig, BadInput, TimedOut, ZmavError
from zmav.process import say
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.waiting import alongside, together, within

name_option = click.option(
    "--name", "camera", default="down", show_default=True, help="The camera's name on its vehicle."
)


def pair(text: str) -> tuple[int, int]:
    """Two whole numbers of an option: ``640x480``."""
    found = re.fullmatch(r"(\d{1,5})[x×](\d{1,5})", text.strip())
    if found is None:
        raise click.BadParameter(f"{text!r} is not like 640x480")
    return int(found[1]), int(found[2])


def triple(text: str) -> tuple[float, float, float]:
    """Three numbers of an option: ``0,90,0``."""
    a, b, c = places.numbers(text, 3, "three numbers like 0,90,0")
    return a, b, c


def rate_bytes(text: str) -> float:
    """A rate of an option, in B/s: ``60kB/s`` or ``480 kbit/s``."""
    try:
        return bits_per_second(text, "rate") / 8.0
    except BadInput as e:
        raise click.BadParameter(str(e)) from e


link_option = click.option(
    "--link",
    type=rate_bytes,
    metavar="RATE",
    help="What our link has for this, as 60kB/s.  [default: the camera finds out]",
)


@click.group("camera")
def camera() -> None:
    """Cameras of vehicles: send pictures, look at what comes of them and record it.

    'zmav camera run 0 --vehicle quad1' beside the camera; 'zmav camera view quad1' anywhere in the fleet.
    """


USUAL_FOV = math.radians(63.0)


@camera.command("run")
@click.argument("source")
@click.option("--vehicle", required=True, help="The vehicle that the camera is on.")
@name_option
@click.option("--rate", type=Between(0.2, 60.0), default=10.0, show_default=True, help="Pictures a second.")
@click.option("--size", type=pair, metavar="WxH", default="640x480", show_default=True, help="Pixels at most.")
@click.option("--quality", type=click.IntRange(10, 95), default=70, show_default=True, help="Of JPEG.")
@click.option(
    "--budget",
    type=rate_bytes,
    metavar="RATE",
    default="60kB/s",
    show_default=True,
    help="To begin with, and for readers that do not report.",
)
@click.option("--calibration", type=click.Path(path_type=Path), help="A file of the lens's constants: docs/camera.md.")
@click.option("--fov", type=Between(3.0, 170.0), metavar="DEG", help="Horizontal field of view instead.")
@click.option("--mount", type=triple, metavar="R,P,Y", help="Degrees from straight down; 0,90,0 looks ahead.")
@click.option("--offset", type=triple, metavar="F,R,D", help="Metres forward, right, down of the vehicle.")
@click.option("--gimbal", is_flag=True, help="It is levelled: only the vehicle's heading counts.")
@click.option(
    "--delay",
    type=Between(0.0, 5.0),
    default=0.0,
    show_default=True,
    metavar="S",
    help="From shutter to us, where the source does not say when a picture was taken.",
)
@click.option("--loop", is_flag=True, help="A folder begins again at its end.")
@click.option(
    "--capture",
    type=pair,
    metavar="WxH",
    help="Asked of a device, and the size of photos.  [default: as --size]",
)
@click.option(
    "--photos",
    type=click.Path(file_okay=False, path_type=Path),
    default="photos",
    show_default=True,
    help="Where photos are kept.",
)
@connected
def run_camera(
    source: str,
    rate: float,
    delay: float,
    loop: bool,
    capture: tuple[int, int] | None,
    photos: Path,
    calibration: Path | None,
    fov: float | None,
    mount: tuple[float, float, float] | None,
    offset: tuple[float, float, float] | None,
    gimbal: bool,
    size: tuple[int, int],
    **rest: Any,
) -> Work:
    """Send a camera's pictures: 'zmav camera run 0 --vehicle quad1'.

    SOURCE is a V4L2 device (0, /dev/video0), a URL (rtsp://..., or http://... of multipart JPEG, as the simulator
    serves) or a folder of pictures. Pictures go out while somebody reads them, as many, as large and as
    good as the tightest reader's link takes. SIGTERM ends it.
    """
    if calibration is not None and fov is not None:
        raise BadConfig("give --calibration or --fov, not both", field="fov", value=fov, expected="one of the two")
    opened = open_source(source, rate=rate, loop=loop, delay=delay, size=capture or size)
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
    return lambda z: _run(z, given, opened, lens, photos)


def _lens(calibration: Path | None, fov: float | None, found: SimulatedLens | None) -> Calibration | float:
    if calibration is not None:
        return Calibration.load(calibration)
    if fov is not None:
        return math.radians(fov)
    if found is not None:
        return found.calibration
    say(f"no --calibration and no --fov: the lens is taken for {math.degrees(USUAL_FOV):.0f}° wide, without distortion")
    return USUAL_FOV


async def _run(z: zmav.Client, own: CameraSettings, source: Source, lens: Calibration | float, folder: Path) -> None:
    async with (
        CameraAgent(z, own, source, lens, say) as agent,
        Photos(z, agent, folder) as photos,
        alongside(photos.run()),
    ):
        say(f"{z.fleet_name}/{own.vehicle}/{own.camera}: {source.words}, {own.budget / 1e3:.0f} kB/s to begin with")
        await agent.serve()
    say(f"{agent.sent} pictures sent")


def _agent_order(vehicles: str, camera: str, verb: str, as_json: bool, **args: Any) -> Work:
    """Have the program of each vehicle's camera do something."""

    async def give(z: zmav.Client) -> None:
        failed = False
        for vehicle in await matching(z, vehicles):
            try:
                said = await vehicle.tell(f"{PREFIX}{camera}", verb, **args)
            except ZmavError as e:
                failed, silent = True, "no 'zmav camera run' of that camera answers"
                said = {"error": e.code, "message": silent if isinstance(e, TimedOut) else e.message}
            words = said.get("message") or said.get("file") or ", ".join(f"{k} {v}" for k, v in said.items())
            click.echo(dump({"vehicle": vehicle.name, **said}) if as_json else f"{vehicle.name}/{camera}: {words}")
        if failed:
            raise SystemExit(1)

    return give


@camera.command("photo")
@click.argument("vehicles")
@name_option
@click.option("--every", type=Between(0.2, 3600.0), metavar="S", help="A series; ends with --stop or --count.")
@click.option("--count", type=click.IntRange(1), help="So many of a series.")
@click.option("--stop", is_flag=True, help="End a series.")
@json_option
@connected
def take_photo(vehicles: str, camera: str, every: float | None, count: int | None, stop: bool, as_json: bool) -> Work:
    """Take a photo: 'zmav camera photo quad1'. It is kept on the vehicle, with when and where it was taken.

    The whole picture of the source, in the folder of its 'zmav camera run'; the place is in its EXIF, the attitude in
    the .json beside it.
    """
    if stop and (every or count):
        raise click.UsageError("--stop goes with neither --every nor --count")
    if count is not None and every is None:
        raise click.UsageError("--count goes with --every")
    if stop:
        return _agent_order(vehicles, camera, "stop", as_json)
    series = {} if every is None else {"every": every, "count": count or 0}
    return _agent_order(vehicles, camera, "photo", as_json, **series)


@camera.command("zoom")
@click.argument("vehicles")
@click.argument("factor", type=Between(1.0, MOST_ZOOM))
@name_option
@json_option
@connected
def zoom_camera(vehicles: str, factor: float, camera: str, as_json: bool) -> Work:
    """Look closer: 'zmav camera zoom quad1 4' sends the middle of the picture; 1 all of it. Photos stay whole."""
    return _agent_order(vehicles, camera, "zoom", as_json, factor=factor)


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


@camera.command("view")
@click.argument("vehicle")
@name_option
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Write all pictures as they come, and a .csv of when each was taken.",
)
@click.option("--wait", type=Between(0.1), default=10.0, show_default=True, help="Seconds for a first picture.")
@link_option
@connected
def view_camera(vehicle: str, camera: str, record: Path | None, wait: float, link: float | None) -> Work:
    """Show what comes of a camera each second: rate, delay, size, loss. 'zmav view' shows the pictures themselves.

    The delay is from shutter to here, by both computers' clocks. What --record has written stays whole whatever ends
    it; nothing is written while less than 1 GB is free.
    """

    async def view(z: zmav.Client) -> None:
        async with Reader(z, vehicle, camera, name="view", most_bytes=link) as pictures:
            try:
                first = await within(wait, pictures.get())
            except asyncio.TimeoutError:
                await camera_info(z, vehicle, camera)  # raises where there is no such camera
                text = f"{vehicle}/{camera} is there, but sent no whole picture within {wait:g} s"
                raise TimedOut(text, vehicle=vehicle) from None
            with contextlib.closing(PictureRecorder(record)) if record else contextlib.nullcontext() as recorder:
                since = [first]
                await together(_take(pictures, since, recorder), _tell(pictures, since, recorder))

    return view


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
