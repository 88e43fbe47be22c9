"""A vehicle's cameras as nodes of ROS, ``/{vehicle}/camera_{name}``: pictures as JPEG, each with its CameraInfo.

A camera sends pictures only while somebody subscribes to them here, and as many as the way to us carries
(docs/camera.md). Its CameraInfo alone needs none.
"""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

import numpy as np

from ground.ros2 import convert, frames, graph
from ground.ros2.node import Ros
from ground.ros2.qos import LATCHED, SENSOR
from ground.ros2.types import Types
from ground.ros2.watch import Watch, WhileWanted
from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import BadInput, BadKey, ZmavError
from zmav.vehicle import Vehicle
from zmav.vision.reader import Picture, Reader
from zmav.waiting import cancelled

logger = logging.getLogger(__name__)
MOST = 8
"""cameras of one vehicle"""
LOOK = 5.0
"""s between two questions which cameras there are: one is a few hundred bytes over the radio"""
PATIENCE = 2.0
"""s for their answers"""
GONE = 3
"""questions in a row that a camera left unanswered: it is there no more"""
ALONE = 1.0
"""s between two CameraInfos where nobody takes the pictures that they come with otherwise"""


class Camera:
    """One camera. Lives on the event loop. ``name``: the vehicle's in ROS."""

    def __init__(self, z: Client, ros: Ros, watch: Watch, vehicle: Vehicle, name: str, info: wire.CameraInfo) -> None:
        self._z, self._watch, self._vehicle, self._types = z, watch, vehicle, ros.types
        camera = graph.ros_name(info.camera)
        self._frame = f"{name}/{camera}"
        self._node = ros.node(f"/{name}", f"camera_{camera}")
        base = f"camera/{camera}"
        self._pictures = self._node.publish(f"{base}/image_raw/compressed", "sensor_msgs/msg/CompressedImage", SENSOR)
        self._infos = self._node.publish(f"{base}/camera_info", "sensor_msgs/msg/CameraInfo", SENSOR)
        self._reading, self._telling = WhileWanted(self._read), WhileWanted(self._tell)
        watch.offer(self._pictures.endpoint, self._reading)
        watch.offer(self._infos.endpoint, self._telling)
        self._base = f"{name}/base_link"
        self._places = self._node.publish("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        self._placed: tuple[wire.Vector, wire.Vector] | None = None
        """mount and offset that were said"""
        self.take(info)

    def take(self, info: wire.CameraInfo) -> None:
        """What the camera says now. Where it is goes to /tf_static, but for a gimbal's, which turns by itself."""
        self.info, self.missed = info, 0
        place = info.mount, info.offset
        if not info.gimbal and self._placed != place and all(map(math.isfinite, (*info.mount, *info.offset))):
            self._placed = place
            self._places(placed(self._types, self._base, self._frame, info))

    @property
    def read(self) -> bool:
        """Somebody takes its pictures."""
        return bool(self._reading)

    async def close(self) -> None:
        for publisher in (self._pictures, self._infos):
            self._watch.withdraw(publisher.endpoint)
        await self._reading.close()
        await self._telling.close()
        self._node.close()

    async def _read(self) -> None:
        async with Reader(self._z, self._vehicle.name, self.info.camera, name="ros2") as pictures:
            async for picture in pictures:
                try:
                    header = convert.header(self._types, self._frame, picture.t)
                    self._pictures(compressed(self._types, header, picture))
                    if self._telling:
                        size = picture.width, picture.height
                        self._infos(camera_info(self._types, header, self.info, size))
                except Exception:
                    logger.exception("a picture of %s was not published", self._frame)

    async def _tell(self) -> None:
        """Without pictures; with them, each brings its own."""
        while True:
            if not self._reading:
                size = self.info.width, self.info.height
                try:
                    header = convert.header(self._types, self._frame, self.info.t)
                    self._infos(camera_info(self._types, header, self.info, size))
                except Exception:
                    logger.exception("the CameraInfo of %s was not published", self._frame)
            await asyncio.sleep(ALONE)


class Cameras:
    """Those of one vehicle, as long as each is there. Lives on the event loop."""

    def __init__(self, z: Client, ros: Ros, watch: Watch, vehicle: Vehicle, name: str) -> None:
        self._z, self._ros, self._watch, self._vehicle, self._name = z, ros, watch, vehicle, name
        self.cameras: dict[str, Camera] = {}
        """by their names in ROS"""
        self._looking = asyncio.create_task(self._look())

    async def close(self) -> None:
        await cancelled(self._looking)
        for camera in self.cameras.values():
            await camera.close()
        self.cameras.clear()

    async def _look(self) -> None:
        while True:
            try:
                await self._meet(await self._ask())
            except ZmavError as e:
                logger.debug("which cameras %s has: %s", self._vehicle.name, e)
            except Exception:
                logger.exception("which cameras %s has was not found", self._vehicle.name)
            await asyncio.sleep(LOOK)

    async def _ask(self) -> dict[str, wire.CameraInfo]:
        """What each camera says of itself, by its name in ROS; what is no such answer is left out."""
        found: dict[str, wire.CameraInfo] = {}
        key = keys.CAMERA.key(self._vehicle.fleet, self._vehicle.name, camera="*")
        for answer in await self._z.ask(key, timeout=PATIENCE, channel=keys.CAMERA):
            if not isinstance(answer, Answer):
                continue
            try:
                info = wire.decode(answer.payload, wire.CameraInfo, f"reply to {key}")
                found.setdefault(graph.ros_name(keys.check_name(info.camera, "camera")), info)
            except (BadInput, BadKey):
                continue
        return found

    async def _meet(self, found: dict[str, wire.CameraInfo]) -> None:
        for name, info in found.items():
            known = self.cameras.get(name)
            if known is not None:
                known.take(info)
            elif len(self.cameras) < MOST:
                self.cameras[name] = Camera(self._z, self._ros, self._watch, self._vehicle, self._name, info)
        for name in self.cameras.keys() - found.keys():
            camera = self.cameras[name]
            camera.missed += 1
            if camera.missed >= GONE:
                del self.cameras[name]
                await camera.close()


def compressed(types: Types, header: Any, picture: Picture) -> Any:
    data = np.frombuffer(picture.jpeg, dtype=np.uint8)
    return types.make("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data)


def camera_info(types: Types, header: Any, info: wire.CameraInfo, size: tuple[int, int]) -> Any:
    """Of pictures of ``size``: they are made smaller on a narrow way, and their lens in pixels with them."""
    across, down = size[0] / max(info.width, 1), size[1] / max(info.height, 1)
    (fx, fy), (cx, cy) = info.focal, info.center
    # The middle of the first pixel is 0: edges are scaled, and they are half a pixel before it.
    fx, cx, fy, cy = fx * across, (cx + 0.5) * across - 0.5, fy * down, (cy + 0.5) * down - 0.5
    return types.make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
        width=size[0],
        height=size[1],
        distortion_model="plumb_bob",
        d=np.array(info.distortion, dtype=np.float64),
        k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.array([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    )


def placed(types: Types, base: str, frame: str, info: wire.CameraInfo) -> Any:
    """Where a camera is, and how it is turned, on the vehicle: from ``base`` to ``frame``, a picture's own."""
    x, y, z = frames.flu(info.offset)
    qx, qy, qz, qw = frames.of_camera(info.mount)
    moved = types.make(
        "geometry_msgs/msg/Transform",
        translation=types.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        rotation=types.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    header = convert.header(types, base, info.t)
    one = types.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=frame, transform=moved)
    return types.make("tf2_msgs/msg/TFMessage", transforms=[one])
