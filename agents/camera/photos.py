"""Photos beside the recording, and zoom: an agent next to the one that sends pictures, of the same camera.

A photo is the whole picture of the source, whatever is sent of it over the network.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import shutil
import struct
import time
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import msgspec

from agents.camera.agent import CameraAgent
from agents.camera.capture import Shot
from agents.camera.settings import MOST_ZOOM
from zmav import geo, wire
from zmav.agent import Agent
from zmav.client import Client
from zmav.errors import BadConfig, BadInput, Refused, ZmavError, missing_extra
from zmav.services.orders.orders import Report
from zmav.trust.gate import Origin
from zmav.verbs import Access, Verb
from zmav.vision.opencv import encode
from zmav.waiting import in_thread

PREFIX = "photos-"
"""before the camera's name: what ground stations find it by, too (zmav/services/cameras)"""
QUALITY = 95
"""of a photo's JPEG, where the source gives none"""
KEEP_FREE = 1e9
"""bytes that are left free on the disk"""
EVERY = (0.2, 3600.0)
"""s between two photos of a series"""
MOST = 100_000
WAIT = 3.0
"""s for a picture that is younger than the order"""
POSE = 1.0
"""s: age up to which the vehicle's state says where a photo was taken"""
EXIF, GPS = 0x8769, 0x8825
"""tags of a picture's directories"""


class TakePhotos(wire.Order, kw_only=True):
    """One photo; or ``count`` of them, ``every`` so many seconds, and with 0 until ``stop``."""

    every: float = 0.0
    count: int = 1


class Zoom(wire.Order, kw_only=True):
    """So many times closer than the lens is: the middle of the picture, in what is sent and not in photos."""

    factor: float


class Photos(Agent):
    """``async with Photos(z, camera, folder)``: takes them from a camera that runs. Raises :class:`BadConfig` where
    nobody may write to ``folder``; where Pillow is missing each photo is refused.
    """

    verbs: ClassVar[Mapping[str, Verb]] = MappingProxyType(
        {
            "photo": Verb("photo", TakePhotos, Access.PAYLOAD, "take photos and keep them beside the camera"),
            "stop": Verb("stop", wire.Order, Access.PAYLOAD, "end a series of photos"),
            "zoom": Verb("zoom", Zoom, Access.PAYLOAD, "look closer"),
        }
    )

    def __init__(self, z: Client, camera: CameraAgent, folder: Path, keep_free: float = KEEP_FREE) -> None:
        own = camera.settings
        self.name = f"{PREFIX}{own.camera}"
        super().__init__(z, own.vehicle)
        self.camera, self._folder, self._keep_free = camera, folder, keep_free
        self._stem = f"{own.vehicle}-{own.camera}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            numbers = [re.fullmatch(rf"{self._stem}-(\d+)\.jpg", each.name) for each in folder.iterdir()]
        except OSError as e:
            text = f"cannot keep photos in {folder}: {e.strerror}"
            raise BadConfig(text, field="photos", value=str(folder), expected="a place to write to") from e
        self.taken = max((int(found[1]) for found in numbers if found), default=0)
        """photos in the folder: the last one's number"""
        self._last: dict[str, Any] | None = None
        self._size = (0, 0)
        """width and height of a photo; 0: no picture has come"""
        self._every, self._wrong = 0.0, ""
        self._series: asyncio.Task[None] | None = None
        self._one = asyncio.Lock()

    async def __aexit__(self, *exc: Any) -> None:
        self._end()
        await super().__aexit__(*exc)

    async def run(self) -> None:
        """Say how it stands, also while nothing happens."""
        while True:
            if not self._size[0] and (shot := self.camera.capture.latest) is not None:
                with contextlib.suppress(ZmavError):  # a picture that is none: a later one will tell
                    self._size = (await asyncio.to_thread(_jpeg_of, shot))[1]
            self._tell()
            await asyncio.sleep(1.0)

    # The orders.

    async def on_photo(self, args: TakePhotos, report: Report, origin: Origin | None) -> dict[str, Any]:
        if not 0 <= args.count <= MOST:
            raise BadInput.wrong("count", args.count, f"0 to {MOST}")
        if args.count != 1 and not EVERY[0] <= args.every <= EVERY[1]:
            raise BadInput.wrong("every", args.every, f"{EVERY[0]:g} to {EVERY[1]:g} s")
        self._end()
        if args.count == 1:
            return await self._take()
        self._check_room()
        self._every = args.every
        self._series = asyncio.create_task(self._take_series(args))
        self._tell()
        return {"every": args.every, "count": args.count, "folder": str(self._folder)}

    async def on_stop(self, args: wire.Order, report: Report, origin: Origin | None) -> dict[str, Any]:
        self._end()
        self._tell()
        return {"taken": self.taken}

    async def on_zoom(self, args: Zoom, report: Report, origin: Origin | None) -> dict[str, Any]:
        if not 1.0 <= args.factor <= MOST_ZOOM:
            raise BadInput.wrong("factor", args.factor, f"1 to {MOST_ZOOM:g}")
        self.camera.zoom = args.factor
        self._tell()
        return {"factor": args.factor}

    # Photos.

    def _end(self) -> None:
        if self._series is not None:
            self._series.cancel()
        self._series, self._every, self._wrong = None, 0.0, ""

    async def _take_series(self, args: TakePhotos) -> None:
        due = time.monotonic()
        try:
            for _ in range(args.count or MOST):
                await asyncio.sleep(due - time.monotonic())
                await self._take()
                due = max(due + args.every, time.monotonic())
        except ZmavError as e:
            self._wrong = f"the series of photos has ended: {e.message}"
            self.say("photos", "warning", self._wrong)
        self._every = 0.0
        self._tell()

    def _disk(self) -> tuple[float, float]:
        """Bytes of it, and those that are free; none where the folder is gone."""
        try:
            usage = shutil.disk_usage(self._folder)
        except OSError:
            return 0.0, 0.0
        return float(usage.total), float(usage.free)

    def _check_room(self) -> None:
        if (free := self._disk()[1]) < self._keep_free:
            raise Refused(f"{free / 1e6:.0f} MB are free in {self._folder}: no photo is taken", reason="full")

    async def _take(self) -> dict[str, Any]:
        """Take one and keep it; raises :class:`Refused` where there is no room, or no picture comes."""
        async with self._one:
            self._check_room()
            shot = await self._next()
            state, age = self.vehicle.last_state, self.vehicle.age
            place, attitude = (state.position, state.attitude) if state and (age or 0.0) < POSE else (None, None)
            if place is not None and state is not None and state.velocity is not None:
                place = _carried(place, state.velocity, min(max(shot.t - state.t, -POSE), POSE))
            number = self.taken + 1
            file = self._folder / f"{self._stem}-{number:05d}.jpg"
            told = {"number": number, "file": str(file), "t": shot.t, "camera": self.camera.settings.camera}
            told |= {"position": msgspec.to_builtins(place), "attitude": msgspec.to_builtins(attitude)}
            try:
                self._size = await in_thread(_keep, file, shot, place, told)
            except asyncio.CancelledError:
                self.taken, self._last = (number, told) if file.exists() else (self.taken, self._last)  # kept already
                raise
            except OSError as e:
                raise Refused(f"cannot write {file}: {e.strerror}", reason="disk") from e
            self.taken, self._last = number, told
            self._tell()
            return told

    async def _next(self) -> Shot:
        """A picture of after now."""
        capture = self.camera.capture
        before, until = capture.count, time.monotonic() + WAIT
        while (shot := capture.latest) is None or shot.seq < before:
            if capture.ended or time.monotonic() > until:
                why = capture.lost or ("the source has ended" if capture.ended else "it gives none")
                raise Refused(f"no picture came within {WAIT:g} s: {why}", reason="no picture")
            await asyncio.sleep(0.01)
        return shot

    def _tell(self) -> None:
        (total, free), (width, height) = self._disk(), self._size
        self.status(
            "series" if self._every else "ready",
            self._wrong or f"{self.taken} photos in {self._folder}, {free / 1e9:.1f} GB free",
            width=width,
            height=height,
            taken=self.taken,
            every=self._every,
            zoom=self.camera.zoom,
            most_zoom=MOST_ZOOM,
            total=total,
            free=free,
            photo=self._last,
        )
        self._changed.set()


def _carried(place: wire.GlobalPosition, velocity: wire.Vector, seconds: float) -> wire.GlobalPosition:
    """Where it was so many seconds later than there."""
    north, east, down = (part * seconds for part in velocity)
    lat, lon, amsl = geo.to_global(place, (north, east, down))
    return wire.GlobalPosition(lat_deg=lat, lon_deg=lon, alt_amsl=amsl, alt_rel=place.alt_rel - down)


def _jpeg_of(shot: Shot) -> tuple[bytes, tuple[int, int]]:
    """The whole picture, and its width and height."""
    image = shot.decoded()
    return shot.jpeg or encode(image, QUALITY), (int(image.shape[1]), int(image.shape[0]))


def _keep(file: Path, shot: Shot, place: wire.GlobalPosition | None, told: dict[str, Any]) -> tuple[int, int]:
    """Write the photo, and before it what is known of it; gives its size. In a thread."""
    jpeg, (width, height) = _jpeg_of(shot)
    exif = exif_of(shot.t, place)
    photo = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]  # behind the first marker
    told |= {"width": width, "height": height}
    for path, data in ((file.with_suffix(".json"), msgspec.json.encode(told)), (file, photo)):
        part = path.with_name(f"{path.name}.part")
        part.write_bytes(data)
        part.replace(path)  # anyone who is killed meanwhile leaves no torn picture
    return width, height


def exif_of(t: float, place: wire.GlobalPosition | None) -> bytes:
    """When (UTC s) and where it was taken, as EXIF 2.32 has it."""
    try:
        from PIL.Image import Exif
    except ImportError as e:
        raise missing_extra("a photo's place", "Pillow", "vision") from e
    taken, exif = datetime.fromtimestamp(t, timezone.utc), Exif()
    when = taken.strftime("%Y:%m:%d %H:%M:%S")
    exif[0x010F], exif[0x0132] = "zmav", when
    exif[EXIF] = {0x9003: when, 0x9011: "+00:00", 0x9291: f"{taken.microsecond // 1000:03d}"}
    if place is not None:
        exif[GPS] = {
            0: b"\2\3\0\0",
            1: "N" if place.lat_deg >= 0.0 else "S",
            2: _sexagesimal(place.lat_deg),
            3: "E" if place.lon_deg >= 0.0 else "W",
            4: _sexagesimal(place.lon_deg),
            5: b"\1" if place.alt_amsl < 0.0 else b"\0",
            6: abs(place.alt_amsl),
            7: (taken.hour, taken.minute, taken.second + taken.microsecond / 1e6),
            29: taken.strftime("%Y:%m:%d"),
        }
    return exif.tobytes()


def _sexagesimal(degrees: float) -> tuple[int, int, float]:
    """Degrees, minutes and seconds."""
    minutes, seconds = divmod(abs(degrees) * 3600.0, 60.0)
    return int(minutes // 60), int(minutes % 60), seconds
