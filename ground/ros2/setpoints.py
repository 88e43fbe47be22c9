"""Setpoints as topics of ROS, under MAVROS's names: positions and velocities in the fleet's frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ground.ros2 import frames
from ground.ros2.attachment import Attachment
from ground.ros2.node import RosNode
from ground.ros2.orders import finite, vector
from ground.ros2.steering import Steering
from zmav.errors import BadInput

UNIT = 0.01
"""by which a quaternion's square may differ from 1"""
Fields = Callable[[Any], dict[str, Any]]


def setpoint_topics(node: RosNode, frame: str, steering: Steering) -> None:
    """Take them, on the event loop; ``frame``: the fleet's. What cannot be flown is dropped and said."""

    def checked(header: Any) -> None:
        if header.frame_id not in ("", frame, "map"):  # MAVROS's scripts say "map"
            raise BadInput.wrong("frame_id", header.frame_id[:40], f"{frame}, the fleet's")

    def position(message: Any) -> dict[str, Any]:
        checked(message.header)
        return pose_fields(message.pose)

    def stamped(message: Any) -> dict[str, Any]:
        checked(message.header)
        return velocity(message.twist)

    def taking(fields: Fields) -> Callable[[Any, Attachment], None]:
        def take(message: Any, said: Attachment) -> None:
            try:
                given = fields(message)
            except BadInput as e:
                steering.drop(e)
            else:
                steering.fly(said, given)

        return take

    node.subscribe("setpoint_position/local", "geometry_msgs/msg/PoseStamped", taking(position))
    node.subscribe("setpoint_velocity/cmd_vel", "geometry_msgs/msg/TwistStamped", taking(stamped))
    node.subscribe("setpoint_velocity/cmd_vel_unstamped", "geometry_msgs/msg/Twist", taking(velocity))


def pose_fields(pose: Any) -> dict[str, Any]:
    """A position in the fleet's frame, and the heading of its orientation."""
    return {"pos": vector("position", pose.position), **_yaw(pose.orientation)}


def velocity(twist: Any) -> dict[str, Any]:
    """Along east, north, up; it turns counter-clockwise, as ROS has it."""
    rate = finite("angular.z", twist.angular.z)
    return {"vel": vector("linear", twist.linear), "yaw_rate": -rate}


def _yaw(q: Any) -> dict[str, float]:
    """None for a quaternion of zeros, which is no orientation."""
    parts = tuple(finite(f"orientation.{axis}", getattr(q, axis)) for axis in "xyzw")
    square = sum(part * part for part in parts)
    if square == 0.0:
        return {}
    if not math.isclose(square, 1.0, abs_tol=UNIT):
        raise BadInput.wrong("orientation", f"of the length {math.sqrt(square):.3f}", "a unit quaternion, or zeros")
    x, y, z, w = parts
    return {"yaw": frames.heading(frames.yaw_of((x, y, z, w)))}
