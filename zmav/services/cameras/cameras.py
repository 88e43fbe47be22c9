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

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, TimedOut, Unsupported, ZmavError
from zmav.mavlink import Frame, Packer, decode
from zmav.mavlink.results import CommandResult
from zmav.services.cameras.components import CameraComponent
from zmav.services.companion import Companion
from zmav.services.link.port import on_loop

COMPONENTS = range(100, 106)
"""MAV_COMP_ID_CAMERA to MAV_COMP_ID_CAMERA6"""
PHOTOS = "photos-"
"""how the agents that take photos are called, before the camera's name"""
REQUEST_MESSAGE, SET_MODE, ZOOM, PHOTO, PHOTO_STOP, RECORD, RECORD_STOP = 512, 530, 531, 2000, 2001, 2500, 2501
START_STREAMING, STOP_STREAMING = 2502, 2503
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
ZOOM_STEP = 1.25
FAILURES = {TimedOut: CommandResult.FAILED, Unsupported: CommandResult.UNSUPPORTED}
Tell = Callable[[str, str, dict[str, Any]], Awaitable[dict[str, Any]]]
"""gives an agent of the vehicle an order: its name, the verb, the arguments"""


class Cameras:
    """Lives on the event loop, but for :meth:`take`. ``streams``: the configured cameras, and the URI of each that a
    station can open.
    """

    def __init__(self, companion: Companion, streams: Mapping[str, str | None], tell: Tell) -> None:
        self._session, self._port, self._identity = companion.session, companion.port, companion.identity
        self._events, self._tell = companion.events, tell
        self._streams = dict(streams)
        self.cameras: dict[str, CameraComponent] = {}
        self._components: dict[int, str] = {}
        """the cameras by component id; replaced as a whole"""
        self._packers: dict[int, Packer] = {}
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._subscriber: zenoh.Subscriber[Any] | None = None

    def start(self) -> None:
        loop, port = asyncio.get_running_loop(), self._port
        self._on_command = on_loop(loop, self._take)
        status = keys.AGENT_STATUS.key(port.fleet, port.name, agent=f"{PHOTOS}$*")
        self._subscriber = self._session.declare_subscriber(status, on_loop(loop, self._on_status))

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        held: list[Any] = [self._subscriber, *self._publishers.values()]
        for each in held:
            if each is not None:
                each.undeclare()
        self._publishers.clear()

    def tick(self) -> None:
        """Once a second: who is there, and their heartbeats."""
        old = time.monotonic() - (keys.AGENT_STATUS.stale_after or 0.0)
        for name in self._streams:
            self._place(name)
        for camera in list(self.cameras.values()):
            if camera.capturing is not None and camera.heard < old:
                camera.capturing = None
            if camera.capturing is None and camera.name not in self._streams:
                del self.cameras[camera.name]
            elif camera.component in self._others():
                self.cameras.pop(camera.name)
                self._place(camera.name, camera)
        self._components = {camera.component: name for name, camera in self.cameras.items()}
        for component in self._components:
            self._say(component, "HEARTBEAT", type=30, autopilot=8, system_status=4, mavlink_version=3)

    def _others(self) -> set[int]:
        """Components of the vehicle's system that are heard on the autopilot's link."""
        source = self._identity.source
        return {comp for system, comp in list(self._port.splitter.sources) if source and system == source[0]}

    def _place(self, name: str, known: CameraComponent | None = None) -> CameraComponent | None:
        """The camera of that name, with an id that nobody else has; None: there is none left."""
        if name in self.cameras:
            return self.cameras[name]
        taken = self._others() | {camera.component for camera in self.cameras.values()}
        free = next((number for number in COMPONENTS if number not in taken), None)
        if free is None:
            return None
        camera = known or CameraComponent(name, free, self._streams.get(name))
        camera.component = free
        self.cameras[name] = camera
        self._components = {each.component: each.name for each in self.cameras.values()}
        return camera

    def _on_status(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[4].removeprefix(PHOTOS)
        try:
            status = wire.decode(sample.payload.to_bytes(), wire.AgentStatus, f"status of {name}")
        except BadInput:
            return
        camera = None if status.state == "ended" else self._place(name)
        if camera is not None and camera.hear(status) and camera.capturing is not None:
            self._send(camera, "CAMERA_IMAGE_CAPTURED", camera.capturing.taken)

    # What they say.

    def _say(self, component: int, name: str, /, **fields: Any) -> None:
        source = self._identity.source
        if source is None:
            return
        packer = self._packers.get(component)
        if packer is None or packer.sysid != source[0]:
            packer = self._packers[component] = Packer(self._port.dialect, source[0], component)
        key = keys.RX.key(self._port.fleet, self._port.name, sys=source[0], comp=component, msg=name)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(key, **keys.RX.publishing())
        with contextlib.suppress(zenoh.ZError):  # the session has gone
            publisher.put(packer.pack(name, **fields))

    def _send(self, camera: CameraComponent, message: str, which: int = 0) -> int:
        """One of its messages; the MAV_RESULT of being asked for it."""
        fields = camera.fields(message, which)
        if fields is None:
            return CommandResult.UNSUPPORTED
        self._say(camera.component, message, **fields)
        return CommandResult.ACCEPTED

    # What they are told.

    def take(self, frame: Frame, component: int) -> bool:
        """Any thread: a station's frame that is for one of them, and not for the autopilot's link."""
        if component not in self._components:
            return False
        self._on_command(frame, component)
        return True

    def _take(self, frame: Frame, component: int) -> None:
        name = self._port.dialect.name_of(frame.msgid)
        camera = self.cameras.get(self._components.get(component, ""))
        if camera is not None and name in ("COMMAND_LONG", "COMMAND_INT"):
            task = asyncio.get_running_loop().create_task(self._command(camera, frame))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _command(self, camera: CameraComponent, frame: Frame) -> None:
        fields = decode(frame, self._port.dialect)
        number, asker = fields["command"], {"target_system": frame.sysid, "target_component": frame.compid}
        try:
            result = await self._done(camera, number, [fields[f"param{i}"] for i in range(1, 5)])
        except ZmavError as e:
            result = next((result for kind, result in FAILURES.items() if isinstance(e, kind)), CommandResult.DENIED)
            text = f"camera {camera.name}: {e.message}"
            self._events.emit("refused", "warning", text, limit=f"camera {camera.name} {number}", camera=camera.name)
        self._say(camera.component, "COMMAND_ACK", command=number, result=result, **asker)

    async def _done(self, camera: CameraComponent, number: int, params: list[float]) -> int:
        """The MAV_RESULT of a command; raises what its program refuses it with."""
        p1, p2, p3, _ = (p if math.isfinite(p) else 0.0 for p in params)
        message = OLDER.get(number) or (self._port.dialect.name_of(int(p1)) if number == REQUEST_MESSAGE else None)
        if message is not None:
            return self._send(camera, message, int(p2))
        if number in (START_STREAMING, STOP_STREAMING):
            return CommandResult.ACCEPTED if camera.uri else CommandResult.UNSUPPORTED  # it always runs
        if number == SET_MODE and p2 == 0.0:
            return CommandResult.ACCEPTED
        order = self._order(camera, number, p1, p2, p3)
        if order is None:
            return CommandResult.UNSUPPORTED
        if camera.capturing is None:
            raise Unsupported("it takes no photos: 'zmav camera run' is not heard")
        verb, args = order
        await self._tell(f"{PHOTOS}{camera.name}", verb, args)
        return CommandResult.ACCEPTED

    def _order(
        self, camera: CameraComponent, number: int, p1: float, p2: float, p3: float
    ) -> tuple[str, dict[str, Any]] | None:
        """The verb of its program, and the arguments; None: there is none. Raises :class:`Unsupported`."""
        now = camera.capturing
        if number in (RECORD, RECORD_STOP) or (number == SET_MODE and p2):
            raise Unsupported("it records no video here: 'zmav camera view --record' or 'zmav record' on the ground")
        if number == PHOTO:
            return "photo", {"every": p2, "count": int(p3)} if p3 != 1.0 else {}
        if number == PHOTO_STOP:
            return "stop", {}
        if number != ZOOM or now is None:
            return None if number != ZOOM else ("zoom", {})
        if p1 not in (STEP, RANGE):
            raise Unsupported("it zooms by steps or to a percentage")
        wanted = now.zoom * ZOOM_STEP**p2 if p1 == STEP else 1.0 + (now.most_zoom - 1.0) * p2 / 100.0
        return "zoom", {"factor": min(max(wanted, 1.0), now.most_zoom)}
