"""What other nodes of ROS 2 bring: attachments, tokens, and messages with what is made of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ground.ros2 import attachment, graph
from ground.ros2.orders import place
from ground.ros2.qos import SENSOR
from ground.ros2.setpoints import pose_fields, velocity
from ground.ros2.types import known
from tests.fuzz.engine import Target, pure
from zmav import wire

USED: dict[str, Callable[[Any], object]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: pose_fields(message.pose),
    "geometry_msgs/msg/Twist": velocity,
    "zmav_msgs/srv/GoTo_Request": lambda request: wire.encode(place(request)),
    "rcl_interfaces/srv/SetParameters_Request": lambda request: [each.value.type for each in request.parameters],
    "rcl_interfaces/srv/GetParameters_Request": lambda request: list(request.names),
    "zmav_msgs/action/GoTo_SendGoal_Request": lambda request: (bytes(request.goal_id.uuid), place(request.goal)),
    "action_msgs/srv/CancelGoal_Request": lambda request: bytes(request.goal_info.goal_id.uuid),
    "mavros_msgs/srv/SetMode_Request": lambda request: request.custom_mode.upper(),
}
KINDS = sorted(USED)


def said(data: bytes) -> None:
    found = attachment.read(data)
    assert found.encode() == data


def token(data: bytes) -> None:
    text = data.decode("latin-1")
    found = graph.parse(text)
    if found is not None:
        assert graph.parse(found.token) == found


def message(data: bytes) -> None:
    """The first byte chooses the type."""
    name = KINDS[(data[0] if data else 0) % len(KINDS)]
    found = known().decode(data[1:], name)
    known().encode(found, name)
    USED[name](found)


def messages() -> list[bytes]:
    return [bytes([number]) + known().encode(known().make(name), name) for number, name in enumerate(KINDS)]


def tokens() -> list[bytes]:
    node = graph.Node(0, "f9980ee0495eaafb3e38f0d19e2eae12", 1, "/quad1", "zmav")
    ends = (
        graph.Endpoint(node, 2, graph.PUBLISHER, "/quad1/imu/data", "sensor_msgs/msg/Imu", "RIHS01_ab", SENSOR),
        graph.Endpoint(node, 3, graph.SERVER, "/quad1/hold", "std_srvs/srv/Trigger", "RIHS01_cd"),
    )
    return [end.token.encode() for end in ends]


TARGETS = (
    Target("ros2_attachment", pure(said), lambda: [attachment.write(1, bytes(range(16)))], 700),
    Target("ros2_token", pure(token), tokens, 1500),
    Target("ros2_cdr", pure(message), messages, 1500),
)
