"""``zmav video run|ls|show``: a camera's encoded video; what there is, and what comes of it, here or for other
programs.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from pathlib import Path
from typing import Any

import click
import msgspec

import zmav
from agents.camera.cli import link_option, name_option, pair, rate_bytes
from agents.camera.settings import CameraSettings
from agents.camera.streams import Stream, open_stream
from agents.camera.video import VideoAgent
from zmav import keys, wire
from zmav.cli.common import Between, Work, connected, dump, json_option, show_table
from zmav.client import Answer
from zmav.config import load_fleet
from zmav.errors import BadConfig, BadInput, TimedOut
from zmav.process import say
from zmav.vision.mux import Muxer, sdp
from zmav.vision.video import Unit, Units, VideoReader, video_info
from zmav.waiting import in_thread, together, within


@click.group("video")
def video() -> None:
    """Video of vehicles' cameras: H.264 as the camera encodes it, passed through.

    'zmav video run rtsp://CAMERA/main rtsp://CAMERA/sub --vehicle quad1' beside the camera; then it is on the page of
    'zmav http', and 'zmav video show quad1' says anywhere in the fleet what comes. 'zmav camera' sends pictures.
    """


@video.command("run")
@click.argument("sources", nargs=-1, metavar="[SOURCE]...")
@click.option("--vehicle", required=True, help="The vehicle that the camera is on.")
@name_option
@click.option(
    "--file",
    "path",
    type=click.Path(path_type=Path),
    help="A fleet file, whose [vehicles.NAME.cameras] has the sources.",
)
@click.option("--rate", type=Between(1.0, 60.0), default=30.0, show_default=True, help="Hz, asked of a device.")
@click.option(
    "--size", type=pair, metavar="WxH", default="1280x720", show_default=True, help="Pixels, asked of a device."
)
@click.option(
    "--budget",
    type=rate_bytes,
    metavar="RATE",
    default="100kB/s",
    show_default=True,
    help="To begin with, and for readers that do not report.",
)
@click.option(
    "--delay", type=Between(0.0, 5.0), default=0.0, show_default=True, metavar="S", help="From shutter to us."
)
@click.option("--loop", is_flag=True, help="A file begins again at its end.")
@connected
def run_video(
    sources: tuple[str, ...],
    path: Path | None,
    vehicle: str,
    camera: str,
    rate: float,
    size: tuple[int, int],
    budget: float,
    delay: float,
    loop: bool,
) -> Work:
    """Send a camera's video: 'zmav video run rtsp://192.168.144.25:8554/main --vehicle quad1'.

    A SOURCE is a V4L2 device that encodes (/dev/video0), a URL (rtsp://, udp:// of MPEG-TS...), a file of H.264, the
    simulator's http://HOST:PORT/NAME.mjpeg (encoded here), or 'clock', a test picture. Several are one view, the one
    with most bytes first: the first that the link takes is sent. Nothing is sent while nobody watches. SIGTERM ends it.
    """
    given = _sources(sources, path, vehicle, camera)
    streams = [open_stream(each, rate=rate, loop=loop, delay=delay, size=size) for each in given]
    own = CameraSettings(vehicle=vehicle, camera=camera, rate=rate, budget=budget).check()
    return lambda z: _run(z, own, streams)


def _sources(sources: tuple[str, ...], path: Path | None, vehicle: str, camera: str) -> list[str]:
    if bool(sources) == (path is not None):
        raise BadConfig("give a SOURCE, or --file", field="source", value=list(sources), expected="one of the two")
    if path is None:
        return list(sources)
    cameras = load_fleet(path).vehicle(vehicle).cameras
    if camera not in cameras:
        known = ", ".join(cameras) or "none"
        text = f"{path}: {vehicle} has no camera {camera!r}; it has {known}"
        raise BadConfig(text, field=f"vehicles.{vehicle}.cameras", value=camera, expected=known)
    return cameras[camera].streams


async def _run(z: zmav.Client, own: CameraSettings, streams: list[Stream]) -> None:
    async with VideoAgent(z, own, streams, say) as agent:
        what = f"{agent.stream.words}, {own.budget / 1e3:.0f} kB/s to begin with"
        say(f"{z.fleet_name}/{own.vehicle}/{own.camera}: {what}")
        await agent.serve()
    say(f"{agent.sent} units sent, {agent.dropped} dropped")


@video.command("ls")
@click.option("--wait", type=Between(0.1, 30.0), default=1.0, show_default=True, help="Seconds for answers.")
@json_option
@connected
def list_video(wait: float, as_json: bool) -> Work:
    """Which cameras of the fleet have video, and how it is."""

    async def ask(z: zmav.Client) -> None:
        key = keys.VIDEO_INFO.key(z.fleet_name, "*", camera="*")
        answers = await z.ask(key, timeout=wait, channel=keys.VIDEO_INFO)
        found: list[tuple[str, wire.VideoInfo]] = []
        for each in answers:
            with contextlib.suppress(BadInput):
                if isinstance(each, Answer):
                    found.append((each.key.split("/")[2], wire.decode(each.payload, wire.VideoInfo, each.key)))
        _show(sorted(found, key=lambda one: (one[0], one[1].camera)), as_json)

    return ask


def _show(found: list[tuple[str, wire.VideoInfo]], as_json: bool) -> None:
    if as_json:
        for vehicle, info in found:
            click.echo(dump({"vehicle": vehicle, **msgspec.to_builtins(info)}))
        return
    rows = [
        (
            vehicle,
            info.camera,
            f"{info.width}x{info.height}" if info.width else "-",
            f"{info.rate_hz:.0f} Hz",
            f"{info.rate_bytes / 1e3:.0f} kB/s",
            f"{info.stream} of {info.streams}" + (", key frames only" if info.key_frames_only else ""),
            info.lost or info.source,
        )
        for vehicle, info in found
    ]
    show_table(("vehicle", "camera", "size", "rate", "bytes", "stream", "source"), rows)


@video.command("show")
@click.argument("vehicle")
@name_option
@click.option(
    "--to",
    metavar="WHERE",
    help="Pass it on: udp://HOST:PORT or tcp://HOST:PORT (MPEG-TS), rtp://HOST:PORT, or a file (MPEG-TS).",
)
@click.option("--sdp", "description", type=click.Path(path_type=Path), help="With rtp://: write what a player reads.")
@click.option("--wait", type=Between(0.1), default=10.0, show_default=True, help="Seconds for a first unit.")
@link_option
@json_option
@connected
def show_video(
    vehicle: str,
    camera: str,
    to: str | None,
    description: Path | None,
    wait: float,
    link: float | None,
    as_json: bool,
) -> Work:
    """Show each second what comes of a camera's video; with --to pass it on to another program.

    'zmav video show quad1 --to udp://127.0.0.1:5600', then 'ffplay udp://127.0.0.1:5600', or QGroundControl with
    "MPEG-TS (h.264) Video Stream" at port 5600. The delay is from shutter to here, by both computers' clocks.
    """
    if description is not None:
        if to is None or not to.startswith("rtp://"):
            raise BadConfig(
                "--sdp goes with --to rtp://HOST:PORT", field="sdp", value=str(description), expected="rtp://"
            )
        try:
            description.write_text(sdp(to))
        except OSError as e:
            text = f"cannot write {description}: {e.strerror}"
            raise BadConfig(text, field="sdp", value=str(description), expected="a place to write to") from e

    async def show(z: zmav.Client) -> None:
        async with VideoReader(z, vehicle, camera, name="show", most_bytes=link) as reader:
            with reader.units() as units:
                try:
                    first = await within(wait, units.get())
                except asyncio.TimeoutError:
                    info = await video_info(z, vehicle, camera)  # raises where there is no such camera
                    text = f"{vehicle}/{camera} is there, but no key frame came within {wait:g} s"
                    raise TimedOut(f"{text}: {info.lost}" if info.lost else text, vehicle=vehicle) from None
                since = [first]
                await together(_pass_on(units, since, to), _tell(reader, units, since, as_json))

    return show


async def _pass_on(units: Units, since: list[Unit], to: str | None) -> None:
    """The first one came already."""
    (unit,) = since
    muxer = await in_thread(lambda: Muxer(to, unit)) if to is not None else None
    try:
        while True:
            if muxer is not None:
                await in_thread(muxer.add, unit)  # whose end is waited for before it is closed
            unit = await units.get()
            since.append(unit)
    finally:
        if muxer is not None:
            with contextlib.suppress(BadInput):  # why we end is known already
                await in_thread(muxer.close)


async def _tell(reader: VideoReader, units: Units, since: list[Unit], as_json: bool) -> None:
    start = time.monotonic()
    while True:
        await asyncio.sleep(1.0)
        now = time.monotonic()
        told = _figures(since, now - start)
        told |= {"torn": reader.assembler.torn, "bad": reader.assembler.bad, "dropped": units.dropped}
        late = "-" if told["delay"] is None else f"{1e3 * told['delay']:.0f}"
        line = (
            f"{told['width']}x{told['height']}  {told['rate_hz']} Hz  {late} ms  {told['rate_bytes'] / 1e3:.0f} kB/s  "
            f"{told['key_frames']} key frames, {told['torn']} torn, {told['bad']} bad, {told['dropped']} dropped"
        )
        click.echo(dump(told) if as_json else line)
        start = now
        since.clear()


def _figures(came: list[Unit], seconds: float) -> dict[str, Any]:
    delays = sorted(unit.arrived - unit.t for unit in came)
    return {
        "width": came[-1].width if came else 0,
        "height": came[-1].height if came else 0,
        "rate_hz": round(len(came) / seconds, 1),
        "rate_bytes": round(sum(len(unit.data) for unit in came) / seconds),
        "key_frames": sum(unit.key for unit in came),
        "delay": round(delays[len(delays) // 2], 4) if delays else None,
    }
