"""Two vehicles fly a square side by side, by ROS 2 alone: MAVROS's services and topics, no ROS installed.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
zmav ros2 --orders                            # in a third
python ground/examples/ros2/square.py         # pip install zenoh-ros2-sdk; or with a router: tcp/10.0.0.7:7447
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

from zenoh_ros2_sdk.publisher import ROS2Publisher
from zenoh_ros2_sdk.service_client import ROS2ServiceClient
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber

from ground.ros2.types import INTERFACES, known

SIDE, HEIGHT = 8.0, 6.0  # m
POSE = "geometry_msgs/msg/PoseStamped"


class Quad:
    """One vehicle in ROS: where it is, its setpoints, its services."""

    def __init__(self, name: str, router: dict[str, Any]) -> None:
        self.name, self._router, self.pose = name, router, None
        text, digest = known().definition(POSE), known().hash(POSE)
        ROS2Subscriber(f"/{name}/local_position/pose", POSE, self._on_pose, text, type_hash=digest, **router)
        self._point = ROS2Publisher(f"/{name}/setpoint_position/local", POSE, text, type_hash=digest, **router)

    def _on_pose(self, message: Any) -> None:
        self.pose = message

    def call(self, service: str, kind: str, **fields: Any) -> bool:
        package, what, name = kind.split("/")
        request, answer = f"\n{(INTERFACES / package / what / f'{name}.srv').read_text()}".split("\n---\n")
        request = request.strip() or "uint8 structure_needs_at_least_one_member"
        digest = known().hash(kind)
        client: Any = ROS2ServiceClient(
            f"/{self.name}/{service}", kind, request, answer, type_hash=digest, **self._router
        )
        said = client.call(**fields)
        return bool(said and said.success)

    def fly(self) -> None:
        while self.pose is None or not self.call("cmd/arming", "mavros_msgs/srv/CommandBool", value=True):
            time.sleep(0.5)  # not ready yet: why is on /rosout
        start, nowhere = self.pose.pose.position, dict.fromkeys(("min_pitch", "yaw", "latitude", "longitude"), 0.0)
        self.call("cmd/takeoff", "mavros_msgs/srv/CommandTOL", altitude=HEIGHT, **nowhere)
        while self.pose.pose.position.z < start.z + HEIGHT - 0.5:
            time.sleep(0.1)
        for east, north in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0)):
            self.go(start.x + east, start.y + north, start.z + HEIGHT)
            text = f"{self.name}: corner {east:.0f} m east, {north:.0f} m north\n"
            print(text, end="", flush=True)  # in one piece: the other vehicle's thread prints, too
        self.call("land", "std_srvs/srv/Trigger", structure_needs_at_least_one_member=0)

    def go(self, x: float, y: float, z: float) -> None:
        """A point in the fleet's frame, ten times a second until it is there."""
        point = known().make("geometry_msgs/msg/Point", x=x, y=y, z=z)
        wanted = known().make(POSE, pose=known().make("geometry_msgs/msg/Pose", position=point))
        while self.pose is None or math.dist((x, y), (self.pose.pose.position.x, self.pose.pose.position.y)) > 0.7:
            self._point.publish(header=wanted.header, pose=wanted.pose)
            time.sleep(0.1)


def main(endpoint: str = "tcp/127.0.0.1:7447") -> None:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    router: dict[str, Any] = {"router_ip": host, "router_port": int(port)}
    flights = [threading.Thread(target=Quad(name, router).fly) for name in ("quad1", "quad2")]
    for flight in flights:
        flight.start()
    for flight in flights:
        flight.join()
    ZenohSession.get_instance(**router).close()


if __name__ == "__main__":
    main(*sys.argv[1:])
