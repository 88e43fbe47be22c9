"""What a fleet's planner has one vehicle fly, as a path: heard while somebody subscribes to it."""

from __future__ import annotations

from functools import partial
from typing import Any

from ground.ros2 import convert, frames
from ground.ros2.node import RosNode
from ground.ros2.qos import LATCHED
from ground.ros2.types import Types
from ground.ros2.watch import Watch, WhileWanted, hear
from zmav.client import Client
from zmav.wire import swarm

MOST = 2000
"""places of one path"""
UNTURNED = (0.0, 0.0, 0.0, 1.0)


class Plans:
    """Of one vehicle. Lives on the event loop. ``frame``: the fleet's."""

    def __init__(self, z: Client, node: RosNode, watch: Watch, fleet: str, vehicle: str, frame: str) -> None:
        self._types, self._watch, self._vehicle, self._frame = node.ros.types, watch, vehicle, frame
        self._path = node.publish("plan", "nav_msgs/msg/Path", LATCHED)
        self._hearing = WhileWanted(partial(hear, z, fleet, "plan", swarm.PlanReport, self._tell))
        watch.offer(self._path.endpoint, self._hearing)

    async def close(self) -> None:
        self._watch.withdraw(self._path.endpoint)
        await self._hearing.close()

    @property
    def heard(self) -> bool:
        """Somebody subscribes."""
        return bool(self._hearing)

    def _tell(self, plan: swarm.PlanReport) -> None:
        if track := plan.tracks.get(self._vehicle):
            self._path(path(self._types, self._frame, plan.start, track))


def path(types: Types, frame: str, start: float, track: list[tuple[float, float, float, float]]) -> Any:
    """Each place with the time (UTC) at which the vehicle is to be there. Headings are no part of a plan."""
    view, poses = convert.View(types, frame, "", None, {}, start), []
    for after, north, east, down in track[:MOST]:
        pose, then = view.pose(frames.enu((north, east, down)), UNTURNED), convert.header(types, frame, start + after)
        poses.append(types.make("geometry_msgs/msg/PoseStamped", header=then, pose=pose))
    return types.make("nav_msgs/msg/Path", header=view.header(frame), poses=poses)
