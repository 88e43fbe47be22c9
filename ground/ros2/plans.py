"""What a fleet's planner has one vehicle fly, as a path: heard while somebody subscribes to it."""

from __future__ import annotations

import logging
from typing import Any

import zenoh

from ground.ros2 import convert, frames
from ground.ros2.node import RosNode
from ground.ros2.qos import LATCHED
from ground.ros2.types import Types
from ground.ros2.watch import Watch, WhileWanted
from zmav import keys, wire
from zmav.client import Client
from zmav.wire import swarm

logger = logging.getLogger(__name__)
MOST = 2000
"""places of one path"""
UNTURNED = (0.0, 0.0, 0.0, 1.0)


class Plans:
    """Of one vehicle. Lives on the event loop. ``frame``: the fleet's."""

    def __init__(self, z: Client, node: RosNode, watch: Watch, fleet: str, vehicle: str, frame: str) -> None:
        self._z, self._types, self._watch = z, node.ros.types, watch
        self._fleet, self._vehicle, self._frame = fleet, vehicle, frame
        self._path = node.publish("plan", "nav_msgs/msg/Path", LATCHED)
        self._hearing = WhileWanted(self._hear)
        watch.offer(self._path.endpoint, self._hearing)

    async def close(self) -> None:
        self._watch.withdraw(self._path.endpoint)
        await self._hearing.close()

    @property
    def heard(self) -> bool:
        """Somebody subscribes."""
        return bool(self._hearing)

    async def _hear(self) -> None:
        key = keys.FLEET.key(self._fleet, topic="plan")

        def convert_sample(sample: zenoh.Sample) -> swarm.PlanReport:
            return wire.decode(sample.payload.to_bytes(), swarm.PlanReport, key)

        async with self._z.subscribe(key, convert_sample) as plans:
            async for plan in plans:
                track = plan.tracks.get(self._vehicle)
                try:
                    if track:
                        self._path(path(self._types, self._frame, plan.start, track))
                except Exception:
                    logger.exception("a plan of %s was not published", self._vehicle)


def path(types: Types, frame: str, start: float, track: list[tuple[float, float, float, float]]) -> Any:
    """Each place with the time (UTC) at which the vehicle is to be there. Headings are no part of a plan."""
    view, poses = convert.View(types, frame, "", None, {}, start), []
    for after, north, east, down in track[:MOST]:
        pose, then = view.pose(frames.enu((north, east, down)), UNTURNED), convert.header(types, frame, start + after)
        poses.append(types.make("geometry_msgs/msg/PoseStamped", header=then, pose=pose))
    return types.make("nav_msgs/msg/Path", header=view.header(frame), poses=poses)
