"""What a node of ours says on /rosout, where ROS's users read why something was refused."""

from __future__ import annotations

from ground.ros2 import convert
from ground.ros2.node import RosNode
from ground.ros2.qos import LATCHED

LEVELS = {"emergency": 50, "alert": 50, "critical": 50, "error": 40, "warning": 30, "debug": 10}
"""of rcl_interfaces/Log, by severity; others are 20: INFO"""


class Rosout:
    """Of one node: ``rosout(text)``."""

    def __init__(self, node: RosNode) -> None:
        self._types, self._name = node.ros.types, node.node.path.strip("/").replace("/", ".")
        self._publish = node.publish("/rosout", "rcl_interfaces/msg/Log", LATCHED)

    def __call__(self, text: str, severity: str = "warning") -> None:
        stamp, level = convert.now(self._types), LEVELS.get(severity, 20)
        self._publish(self._types.make("rcl_interfaces/msg/Log", stamp=stamp, level=level, name=self._name, msg=text))
