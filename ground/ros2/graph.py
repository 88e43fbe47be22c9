"""The ROS graph: a liveliness token for each node and for each of its endpoints, and the keys they speak on.

    @ros2_lv/<domain>/<zid>/<nid>/<nid>/NN/<enclave>/<namespace>/<node>
    @ros2_lv/<domain>/<zid>/<nid>/<eid>/MP/<enclave>/<namespace>/<node>/<name>/<type>/<hash>/<qos>
    <domain>/<name without its first slash>/<type>/<hash>

MP publishes, MS subscribes, SS serves, SC asks. In a token ``/`` is written ``%``, and what is empty is ``%``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import xxhash

from ground.ros2.qos import RELIABLE, RosQos
from zmav.errors import BadInput

SPACE = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIBER, SERVER, ASKER = "NN", "MP", "MS", "SS", "SC"
ENDPOINTS = (PUBLISHER, SUBSCRIBER, SERVER, ASKER)
LONGEST = 1024
"""characters of a token that is looked at"""
_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_\Z", re.ASCII)
_ROS = re.compile(r"(\w+)/(msg|srv|action)/(\w+)\Z", re.ASCII)


@dataclass(frozen=True)
class Node:
    """A node: ``namespace`` is ``/quad1``, ``nid`` is unique in its session."""

    domain: int
    zid: str
    nid: int
    namespace: str
    name: str
    enclave: str = ""

    @property
    def token(self) -> str:
        return self.at(self.nid, NODE)

    def at(self, eid: int, kind: str) -> str:
        """The beginning of the tokens of its endpoints."""
        names = f"{_mangled(self.enclave)}/{_mangled(self.namespace.rstrip('/'))}/{self.name}"
        return f"{SPACE}/{self.domain}/{self.zid}/{self.nid}/{eid}/{kind}/{names}"

    @property
    def path(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True)
class Endpoint:
    """What a node publishes, subscribes to, serves or asks. ``type`` is as in ROS: ``sensor_msgs/msg/Imu``."""

    node: Node
    eid: int
    kind: str
    name: str
    """from the root: ``/quad1/imu/data``"""
    type: str
    hash: str
    qos: RosQos = RELIABLE

    @cached_property
    def token(self) -> str:
        what = f"{_mangled(self.name)}/{dds_of(self.type)}/{self.hash}/{self.qos.encode()}"
        return f"{self.node.at(self.eid, self.kind)}/{what}"

    @cached_property
    def gid(self) -> bytes:
        """XXH3 (128 bits) of its token, little endian."""
        return gid_of(self.token)

    @property
    def key(self) -> str:
        return f"{self.node.domain}/{self.name.lstrip('/')}/{dds_of(self.type)}/{self.hash}"


def gid_of(token: str) -> bytes:
    return int(xxhash.xxh3_128_intdigest(token.encode())).to_bytes(16, "little")


def dds_of(ros_type: str) -> str:
    """``sensor_msgs::msg::dds_::Imu_`` for ``sensor_msgs/msg/Imu``."""
    found = _ROS.match(ros_type)
    if found is None:
        raise BadInput(f"no type of ROS: {ros_type[:80]!r}", field="type", value=ros_type[:80], expected="pkg/msg/Name")
    return f"{found[1]}::{found[2]}::dds_::{found[3]}_"


def parse(token: str) -> Endpoint | None:
    """The endpoint that a token stands for; None for a node's, and for what is none: anybody declares tokens."""
    parts = token.split("/")
    if len(token) > LONGEST or len(parts) != 13 or parts[0] != SPACE or parts[5] not in ENDPOINTS:
        return None
    found = _TYPE.match(parts[10])
    if (
        found is None
        or "%" in parts[8]
        or not all(part.isascii() and part.isdigit() for part in (parts[1], *parts[3:5]))
    ):
        return None
    try:
        node = Node(int(parts[1]), parts[2], int(parts[3]), _plain(parts[7]) or "/", parts[8], _plain(parts[6]))
        ros_type, qos = "/".join(found.groups()), RosQos.decode(parts[12])
        return Endpoint(node, int(parts[4]), parts[5], _plain(parts[9]), ros_type, parts[11], qos)
    except BadInput:
        return None


def ros_name(name: str) -> str:
    """A name of ours as ROS takes it: letters, digits and ``_``, no digit first. Two of ours may become one."""
    plain = name.replace("-", "_")
    return f"v_{plain}" if plain[:1].isdigit() else plain


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def _plain(name: str) -> str:
    return "" if name == "%" else name.replace("%", "/")
