"""The vehicle's own cameras, told to ground stations as MAVLink components 100 to 105 of its system.

They speak under the vehicle's keys, not on the autopilot's link: a camera that is wired to the autopilot speaks for
itself there, and keeps its component id.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, BadMessage, Unsupported, ZmavError
from zmav.mavlink import Frame, Packer, decode
from zmav.mavlink.results import CommandResult
from zmav.services.cameras.components import Camera, Capturing
from zmav.services.companion import Companion
from zmav.waiting import on_loop

COMPONENTS = range(100, 106)
"""MAV_COMP_ID_CAMERA to MAV_COMP_ID_CAMERA6"""
PHOTOS = "photos-"
"""how the agents that take photos are called, before the camera's name"""
REQUEST_MESSAGE, SET_MODE, ZOOM, PHOTO, PHOTO_STOP, RECORD, RECORD_STOP = 512, 530, 531, 2000, 2001, 2500, 2501
OLDER = {
    521: "CAMERA_INFORMATION",
    522: "CAMERA_SETTINGS",
    525: "STORAGE_INFORMATION",
    527: "CAMERA_CAPTURE_STATUS",
    2504: "VIDEO_STREAM_INFORMATION",
    2505: "VIDEO_STREAM_STATUS",
}
"""commands that ask for one message, from before REQUEST_MESSAGE"""
STEP, RANGE = 0, 2
"""CAMERA_ZOOM_TYPE"""
ZOOM_STEP, MOST_STEPS = 1.25, 10.0
MOST_PHOTOS = 1e9
"""of a series: a float may be more than an order's number can be; the camera's own limit is far below"""
MOST = 32
"""commands under way"""
Tell = Callable[[str, str, dict[str, Any]], Awaitable[dict[str, Any]]]
"""gives an agent of the vehicle an order: its name, the verb, the arguments"""


async def tell_nobody(agent: str, verb: str, args: dict[str, Any]) -> dict[str, Any]:
    """Where no program beside this one can be told anything."""
    raise Unsupported(f"nobody tells {agent} anything here")


class Cameras:
    """Lives on the event loop, but for :meth:`take`. ``streams``: the configured cameras, and the URI of each that a
    station can open.
    """

    def __init__(self, companion: Companion, streams: Mapping[str, str | None], tell: Tell) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._events, self._tell, self._streams = companion.events, tell, streams
        self.cameras: dict[str, Camera] = {}
        self._packers: dict[tuple[int, int], Packer] = {}
        self._tasks: dict[asyncio.Task[None], tuple[Camera, int]] = {}
        """commands under way: whose, and which"""
        self._held: Any = None

    def start(self) -> None:
        loop, port = asyncio.get_running_loop(), self._port
        self._on_command = on_loop(loop, self._take)
        status = keys.AGENT_STATUS.key(port.fleet, port.name, agent=f"{PHOTOS}$*")
        self._held = self._session.declare_subscriber(status, on_loop(loop, self._on_status))

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        self._held.undeclare()

    def tick(self) -> None:
        """Once a second: who is there, and their heartbeats."""
        for name in self._streams:
            self._find(name)
        for camera in list(self.cameras.values()):
            if time.monotonic() - camera.heard > (keys.AGENT_STATUS.stale_after or 0.0):
                camera.capturing = None
            if camera.capturing is None and camera.name not in self._streams:
                del self.cameras[camera.name]
            elif camera.component in self._others():
                del self.cameras[camera.name]  # one is wired to the autopilot: ours is found again under another id
            else:
                self._say(camera, "HEARTBEAT", type=30, autopilot=8, system_status=4, mavlink_version=3)

    def _others(self) -> set[int]:
        """Components of the vehicle's system that are heard on the autopilot's link."""
        source = self._identity.source
        return {component for system, component in list(self._port.splitter.sources) if source and system == source[0]}

    def _find(self, name: str) -> Camera | None:
        """The camera of that name; a new one has an id that nobody else has, or there is none (None)."""
        taken = self._others() | {camera.component for camera in self.cameras.values()}
        free = next((number for number in COMPONENTS if number not in taken), None)
        if name not in self.cameras and free is not None:
            self.cameras[name] = Camera(name, free, self._streams.get(name))
        return self.cameras.get(name)

    def _on_status(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[4].removeprefix(PHOTOS)
        try:
            status = wire.decode(sample.payload.to_bytes(), wire.AgentStatus, f"status of {name}")
            told = msgspec.convert(status.detail, Capturing)
        except (BadInput, msgspec.ValidationError):
            return  # of another version
        camera = None if status.state == "ended" else self._find(name)
        if camera is None:
            return
        camera.heard = time.monotonic()
        self._learn(camera, told)

    def _learn(self, camera: Camera, told: Capturing) -> None:
        before, camera.capturing = camera.capturing, told
        if before is not None and told.taken > before.taken:
            self._send(camera, "CAMERA_IMAGE_CAPTURED")

    # What they say.

    def _say(self, camera: Camera, message: str, /, **fields: Any) -> None:
        if self._identity.source is None:
            return
        place = self._identity.source[0], camera.component
        packer = self._packers.setdefault(place, Packer(self._port.dialect, *place))
        key = keys.RX.key(self._port.fleet, self._port.name, sys=place[0], comp=place[1], msg=message)
        with contextlib.suppress(zenoh.ZError, BadMessage):  # the session has gone; what no field can hold
            self._session.put(key, packer.pack(message, **fields), **keys.RX.qos.options())

    def _send(self, camera: Camera, message: str) -> int:
        """One of its messages; the MAV_RESULT of being asked for it."""
        try:
            fields = camera.messages().get(message)
        except (OverflowError, ValueError):  # its program tells of numbers that no field can hold
            return CommandResult.FAILED
        if fields is None:
            return CommandResult.UNSUPPORTED
        self._say(camera, message, **fields)
        return CommandResult.ACCEPTED

    # What they are told.

    def take(self, frame: Frame, system: int, component: int) -> bool:
        """Any thread: a station's frame that is for one of them, and not for the autopilot's link nor for another
        vehicle's camera there.
        """
        source = self._identity.source
        if source is None or system not in (0, source[0]):
            return False
        camera = next((each for each in list(self.cameras.values()) if each.component == component), None)
        if camera is not None:
            self._on_command(camera, frame)
        return camera is not None

    def _take(self, camera: Camera, frame: Frame) -> None:
        if self._port.dialect.name_of(frame.msgid) not in ("COMMAND_LONG", "COMMAND_INT"):
            return
        fields = decode(frame, self._port.dialect)
        repeated = fields.get("confirmation", 0) > 0 and (camera, fields["command"]) in self._tasks.values()
        if not repeated and len(self._tasks) < MOST:  # else it is under way, and acknowledged once
            task = asyncio.get_running_loop().create_task(self._command(camera, frame, fields))
            self._tasks[task] = camera, fields["command"]
            task.add_done_callback(lambda task: self._tasks.pop(task, None))

    async def _command(self, camera: Camera, frame: Frame, fields: Mapping[str, Any]) -> None:
        number, params = fields["command"], (fields["param1"], fields["param2"], fields["param3"])
        try:
            result = await self._done(camera, number, *(p if math.isfinite(p) else 0.0 for p in params))
        except ZmavError as e:
            result = CommandResult.UNSUPPORTED if isinstance(e, Unsupported) else CommandResult.FAILED
            text = f"camera {camera.name}: {e.message}"
            self._events.emit("refused", "warning", text, limit=f"camera {camera.name} {number}", camera=camera.name)
        asker = {"target_system": frame.sysid, "target_component": frame.compid}
        self._say(camera, "COMMAND_ACK", command=number, result=result, **asker)

    async def _done(self, camera: Camera, number: int, p1: float, p2: float, p3: float) -> int:
        """The MAV_RESULT of a command; raises what its program refuses it with."""
        message = OLDER.get(number) or (self._port.dialect.name_of(int(p1)) if number == REQUEST_MESSAGE else None)
        if message is not None:
            return self._send(camera, message)
        if number == SET_MODE and p2 == 0.0:
            return CommandResult.ACCEPTED  # it takes pictures
        if number in (SET_MODE, RECORD, RECORD_STOP):
            raise Unsupported("it records no video here: 'zmav camera view --record' or 'zmav record' on the ground")
        if number not in (PHOTO, PHOTO_STOP, ZOOM):
            return CommandResult.UNSUPPORTED
        now = camera.capturing
        if now is None:
            raise Unsupported("it takes no photos: 'zmav camera run' is not heard")
        if number == ZOOM:
            if p1 not in (STEP, RANGE):
                raise Unsupported("it zooms by steps or to a percentage")
            steps = min(max(p2, -MOST_STEPS), MOST_STEPS)
            factor = now.zoom * ZOOM_STEP**steps if p1 == STEP else 1.0 + (now.most_zoom - 1.0) * p2 / 100.0
            verb, args = "zoom", {"factor": min(max(factor, 1.0), now.most_zoom)}
        else:
            count = int(min(max(p3, -1.0), MOST_PHOTOS))
            verb, args = ("stop", {}) if number == PHOTO_STOP else ("photo", {"every": p2, "count": count})
        done = await self._tell(f"{PHOTOS}{camera.name}", verb, args)
        if camera.capturing is not None:  # a station asks what came of it before the next status
            with contextlib.suppress(msgspec.ValidationError):  # of another version
                self._learn(camera, camera.capturing.after(verb, done))
        return CommandResult.ACCEPTED
