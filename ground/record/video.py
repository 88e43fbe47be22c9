"""The video of cameras beside a recording: as it came, in MPEG-TS, of which a file that is cut off holds all but its
end.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import zenoh

from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput, BadKey
from zmav.vision.mux import Muxer
from zmav.vision.video import Unit, Units, VideoReader, pyav
from zmav.waiting import cancelled, in_thread, on_loop

MOST_CAMERAS = 32
PREFIX = "video-"
"""of the names of agents that send video"""
RETRY_S = 5.0
"""s after a file that could not be written, or without room for one"""


class VideoFiles:
    """``async with``: each camera of the vehicles that fit ``patterns`` into files of its own in ``session``,
    ``NAME.CAMERA.001.ts``; of a second fleet's vehicle of that name ``FLEET.NAME.CAMERA.001.ts``. ``room`` says whether
    there is room to write. Raises :class:`BadConfig` without PyAV.
    """

    def __init__(
        self, z: Client, session: Path, patterns: Sequence[str], room: Callable[[], bool], tell: Callable[[str], None]
    ) -> None:
        pyav()
        self.units = 0
        """that were given to a file"""
        self._z, self._session, self._patterns, self._room, self._tell = z, session, patterns, room, tell
        self._tasks: dict[tuple[str, str, str], asyncio.Task[None]] = {}
        self._held: list[Any] = []

    async def __aenter__(self) -> VideoFiles:
        heard = on_loop(asyncio.get_running_loop(), self._heard)
        for pattern in self._patterns:
            key = keys.expression(f"{pattern}/agent/{PREFIX}*/status", self._z.fleet_name)
            self._held.append(self._z.session.declare_subscriber(key, heard))
        return self

    async def __aexit__(self, *exc: object) -> None:
        for each in self._held:
            with contextlib.suppress(zenoh.ZError):  # the session has gone
                each.undeclare()
        await cancelled(*self._tasks.values())

    def _heard(self, sample: zenoh.Sample) -> None:
        """A camera says that it is there."""
        with contextlib.suppress(BadKey):
            key = str(sample.key_expr)
            _, parts = keys.match(key)
            camera = keys.check_name(parts["agent"].removeprefix(PREFIX), "camera")
            place = parts["fleet"], parts["vehicle"], camera
            meant = keys.hears(f"{keys.ROOT}/{self._z.fleet_name}", key) and place not in self._tasks
            if meant and len(self._tasks) < MOST_CAMERAS:
                same = any(other[1:] == place[1:] for other in self._tasks)
                name = ".".join(place if same else place[1:])
                self._tasks[place] = asyncio.create_task(self._record(*place, name))

    async def _record(self, fleet: str, vehicle: str, camera: str, name: str) -> None:
        number, told = 0, ""
        while True:
            try:
                self._look()  # before the camera is made to send
                async with VideoReader(self._z, vehicle, camera, name="record", fleet=fleet) as reader:
                    with reader.units() as units:
                        number += 1
                        await self._write(self._session / f"{name}.{number:03d}.ts", units)
            except (BadInput, OSError) as e:
                if str(e) != told:
                    told = str(e)
                    self._tell(f"the video of {vehicle}/{camera} is not written: {told}")
            await asyncio.sleep(RETRY_S)

    async def _write(self, path: Path, units: Units) -> None:
        """Until there is no room. Raises OSError then, and :class:`BadInput` where the file cannot be written."""
        unit: Unit = await units.get()
        self._look()
        self._session.mkdir(parents=True, exist_ok=True)
        muxer = await asyncio.to_thread(Muxer, str(path), unit)
        try:
            while True:
                self.units += 1
                await in_thread(muxer.add, unit)  # whose end is waited for before it is closed
                unit = await units.get()
                if unit.key:
                    self._look()
        finally:
            with contextlib.suppress(BadInput):  # in the place of a cancellation it would have us begin another file
                await in_thread(muxer.close)

    def _look(self) -> None:
        if not self._room():
            raise OSError("there is too little room")
