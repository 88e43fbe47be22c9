"""One vehicle's topics: each flows while somebody subscribes to it, and what it needs is wanted of the autopilot then.

No ROS subscriber, no telemetry over the radio: what a topic is made from is neither subscribed to nor asked for before.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import zenoh

from ground.ros2 import convert
from ground.ros2.convert import View
from ground.ros2.node import Publisher, RosNode
from ground.ros2.qos import LATCHED, RELIABLE, SENSOR, RosQos
from ground.ros2.watch import Watch
from zmav import keys
from zmav.client import Client
from zmav.direct import direct
from zmav.errors import BadConfig, BadInput, did_you_mean
from zmav.mavlink import decode, parse_frame
from zmav.vehicle import Vehicle
from zmav.vehicle.rates import want_key

logger = logging.getLogger(__name__)
OLD = 2.0
"""s after which a message is not what is now: nothing is made from it"""
READER = "ros2"
IMU = "IMU"
"""stands for the message with accelerations, which each autopilot has by another name"""
POSITION, ATTITUDE, GPS = "GLOBAL_POSITION_INT", "ATTITUDE", "GPS_RAW_INT"
Make = Callable[[View], Any]


class Topic(NamedTuple):
    """``hz``: how often the autopilot is asked for ``messages``; the first of them makes it come."""

    name: str
    type: str
    make: Make
    hz: float
    messages: tuple[str, ...]
    qos: RosQos = SENSOR


TOPICS = {
    topic.name: topic
    for topic in (
        Topic("global_position/global", "sensor_msgs/msg/NavSatFix", convert.fix, 5.0, (POSITION, GPS)),
        Topic("global_position/raw/fix", "sensor_msgs/msg/NavSatFix", convert.raw_fix, 5.0, (GPS,)),
        Topic("global_position/rel_alt", "std_msgs/msg/Float64", convert.rel_alt, 5.0, (POSITION,)),
        Topic("global_position/compass_hdg", "std_msgs/msg/Float64", convert.compass, 5.0, (POSITION,)),
        Topic("imu/data", "sensor_msgs/msg/Imu", convert.imu, 25.0, (ATTITUDE, IMU)),
        Topic("battery", "sensor_msgs/msg/BatteryState", convert.battery, 1.0, ("SYS_STATUS",)),
        Topic("local_position/pose", "geometry_msgs/msg/PoseStamped", convert.pose, 10.0, (POSITION, ATTITUDE)),
        Topic("local_position/odom", "nav_msgs/msg/Odometry", convert.odometry, 10.0, (POSITION, ATTITUDE)),
        Topic(
            "local_position/velocity_local",
            "geometry_msgs/msg/TwistStamped",
            convert.velocity_local,
            10.0,
            (POSITION, ATTITUDE),
        ),
        Topic(
            "local_position/velocity_body",
            "geometry_msgs/msg/TwistStamped",
            convert.velocity_body,
            10.0,
            (POSITION, ATTITUDE),
        ),
        Topic("/tf", "tf2_msgs/msg/TFMessage", convert.transform, 10.0, (POSITION, ATTITUDE), RELIABLE),
    )
}
STATE_TOPICS: tuple[tuple[str, str, Make, RosQos], ...] = (
    ("state", "mavros_msgs/msg/State", convert.state, LATCHED),
    ("extended_state", "mavros_msgs/msg/ExtendedState", convert.extended_state, LATCHED),
)
"""made of the vehicle's state, which every client hears anyway"""


def rates(pairs: tuple[str, ...]) -> dict[str, float]:
    """``TOPIC=HZ``; raises :class:`BadConfig`."""
    found = {}
    for pair in pairs:
        name, _, hz = pair.partition("=")
        if name not in TOPICS:
            text = f"no topic {name!r} has a rate{did_you_mean(name, TOPICS)}"
            raise BadConfig(text, field="rate", value=pair, expected=", ".join(TOPICS))
        try:
            found[name] = float(hz)
            want_key(keys.RX.key("f", "v", sys="*", comp="*", msg="X"), found[name])
        except (ValueError, BadInput) as e:
            text = f"--rate {pair}: expected TOPIC=HZ, above 0 and at most 500"
            raise BadConfig(text, field="rate", value=pair, expected="TOPIC=HZ") from e
    return found


class Telemetry:
    """Lives on the event loop; messages are made on Zenoh's thread, as their frames come."""

    def __init__(self, z: Client, node: RosNode, watch: Watch, vehicle: Vehicle, name: str, hz: Mapping[str, float]):
        self._z, self._node, self._watch, self._vehicle, self._name = z, node, watch, vehicle, name
        self._hz = hz
        self._last: dict[str, tuple[float, dict[str, Any]]] = {}
        self._wanted: dict[str, list[zenoh.LivelinessToken]] = {}
        """tokens by topic"""
        self._heard: dict[str, zenoh.Subscriber[Any]] = {}
        """by message"""
        self._paced: dict[str, tuple[tuple[Topic, Publisher], ...]] = {}
        """what is made when a message comes; replaced, never changed"""
        self._publishers = {topic.name: node.publish(topic.name, topic.type, topic.qos) for topic in TOPICS.values()}
        self._states = [(node.publish(name, kind, qos), make) for name, kind, make, qos in STATE_TOPICS]
        self._said: Any = None
        self._imu = self._key(IMU)
        self.bad = 0
        for topic, publisher in self._publishers.items():
            watch.offer(publisher.endpoint, partial(self._want, TOPICS[topic]))

    def close(self) -> None:
        for publisher in self._publishers.values():
            self._watch.withdraw(publisher.endpoint)
        for topic in TOPICS.values():
            self._want(topic, False)

    @property
    def wanted(self) -> list[str]:
        """The topics that flow."""
        return sorted(self._wanted)

    def publish_state(self) -> None:
        """If a new state has come since the last time."""
        state = self._vehicle.last_state
        if state is None or state is self._said:
            return
        self._said = state
        imu, self._imu = self._imu, self._key(IMU)
        if imu != self._imu:  # only now is it known which autopilot it has
            for topic in [TOPICS[name] for name in self._wanted if IMU in TOPICS[name].messages]:
                self._want(topic, False)
                self._want(topic, True)
        view = self._view(state.t)
        for publisher, make in self._states:
            publisher(make(view))

    def _want(self, topic: Topic, wanted: bool) -> None:
        if wanted == (topic.name in self._wanted):
            return
        if wanted:
            session, hz = self._z.session, self._hz.get(topic.name, topic.hz)
            keys_ = [self._key(message) for message in topic.messages]
            self._wanted[topic.name] = [session.liveliness().declare_token(want_key(key, hz, READER)) for key in keys_]
        else:
            for token in self._wanted.pop(topic.name):
                token.undeclare()
        flowing = [TOPICS[name] for name in self._wanted]
        paced: dict[str, list[tuple[Topic, Publisher]]] = {}
        for each in flowing:
            paced.setdefault(each.messages[0], []).append((each, self._publishers[each.name]))
        self._paced = {message: tuple(made) for message, made in paced.items()}
        self._hear({message for each in flowing for message in each.messages})

    def _hear(self, messages: set[str]) -> None:
        for message in self._heard.keys() - messages:
            self._heard.pop(message).undeclare()
            self._last.pop(message, None)
        for message in messages - self._heard.keys():
            handler = direct(partial(self._on_frame, message))
            self._heard[message] = self._z.session.declare_subscriber(self._key(message), handler)

    def _key(self, message: str) -> str:
        state = self._vehicle.last_state
        if message == IMU:
            message = convert.IMU_OF.get(state.autopilot or "" if state else "", "RAW_IMU")
        return keys.RX.key(self._vehicle.fleet, self._vehicle.name, sys="*", comp="*", msg=message)

    def _view(self, t: float) -> View:
        now = time.monotonic()
        last = {name: fields for name, (at, fields) in list(self._last.items()) if now - at < OLD}
        vehicle = self._vehicle
        return View(self._node.ros.types, fleet_frame(vehicle.fleet), self._name, vehicle.last_state, last, t)

    def _on_frame(self, message: str, sample: zenoh.Sample) -> None:
        """On a thread of Zenoh's."""
        try:
            dialect, state = self._z.dialect, self._vehicle.last_state
            frame = parse_frame(sample.payload.to_bytes(), dialect)
            known = state is not None and state.sysid is not None
            if known and not self._vehicle.is_autopilot(frame.sysid, frame.compid):
                return  # of something else behind the same link
            fields = decode(frame, dialect)
            self._last[str(sample.key_expr).rpartition("/")[2]] = (time.monotonic(), fields)
            made = self._paced.get(message, ())
            if not made:
                return
            view = self._view(self._vehicle.time_of(fields) if "time_boot_ms" in fields else time.time())
            for topic, publisher in made:
                said = topic.make(view)
                if said is not None:
                    publisher(said)
        except BadInput:
            self.bad += 1
        except zenoh.ZError:
            pass  # it is being closed
        except Exception:
            logger.exception("%s of %s was not published", message, self._vehicle.name)


def fleet_frame(fleet: str) -> str:
    """The frame of the fleet's origin."""
    return fleet.replace("-", "_")
