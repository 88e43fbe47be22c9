"""What ``zmav ros2`` would have published of what a recorder hears: for .mcap files that Foxglove shows in 3-D."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from ground.ros2 import graph
from ground.ros2.convert import IMU_OF, View
from ground.ros2.telemetry import IMU, OLD, STATE_TOPICS, TOPICS, fleet_frame
from ground.ros2.types import known
from zmav import wire
from zmav.errors import BadInput
from zmav.mavlink import Dialect, decode, parse_frame

MOST = 300
"""vehicles: invented names must not fill the memory"""
NEEDED = {message for topic in TOPICS.values() for message in topic.messages if message != IMU} | set(IMU_OF.values())


class RosMessage(NamedTuple):
    topic: str
    type: str
    definition: str
    data: bytes


class Vehicle:
    """The last state of one vehicle, and its last messages with when they came (UTC s)."""

    def __init__(self) -> None:
        self.state: wire.VehicleState | None = None
        self.last: dict[str, tuple[float, dict[str, Any]]] = {}


class Recorded:
    """Of all vehicles, as it comes. One thread at a time."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect, self._types = dialect, known()
        self._vehicles: dict[tuple[str, str], Vehicle] = {}
        self._definitions: dict[str, str] = {}

    def frame(self, fleet: str, name: str, message: str, data: bytes, t: float) -> Iterator[RosMessage]:
        """What a frame makes; nothing where it is none, or of another component than the autopilot. ``t``: UTC s."""
        vehicle = self._of(fleet, name)
        if vehicle is None or message not in NEEDED:
            return
        state = vehicle.state
        with contextlib.suppress(BadInput):
            frame = parse_frame(data, self._dialect)
            if state is None or (frame.sysid, frame.compid) != (state.sysid, state.compid):
                return
            vehicle.last[message] = (t, decode(frame, self._dialect))
            view = self._view(fleet, name, vehicle, t)
            for topic in TOPICS.values():
                if topic.messages[0] == message and (made := topic.make(view)) is not None:
                    yield self._said(name, topic.name, topic.type, made)

    def state(self, fleet: str, name: str, data: bytes, t: float) -> Iterator[RosMessage]:
        vehicle = self._of(fleet, name)
        if vehicle is None:
            return
        with contextlib.suppress(BadInput):
            vehicle.state = wire.decode(data, wire.VehicleState, "state")
            view = self._view(fleet, name, vehicle, t)
            for topic, kind, make, _ in STATE_TOPICS:
                yield self._said(name, topic, kind, make(view))

    def _of(self, fleet: str, name: str) -> Vehicle | None:
        if (fleet, name) not in self._vehicles and len(self._vehicles) < MOST:
            self._vehicles[fleet, name] = Vehicle()
        return self._vehicles.get((fleet, name))

    def _view(self, fleet: str, name: str, vehicle: Vehicle, t: float) -> View:
        last = {message: fields for message, (at, fields) in vehicle.last.items() if 0.0 <= t - at < OLD}
        return View(self._types, fleet_frame(fleet), graph.ros_name(name), vehicle.state, last, t)

    def _said(self, name: str, topic: str, kind: str, message: Any) -> RosMessage:
        if kind not in self._definitions:
            self._definitions[kind] = self._types.definition(kind)
        full = topic if topic.startswith("/") else f"/{graph.ros_name(name)}/{topic}"
        return RosMessage(full, kind, self._definitions[kind], self._types.encode(message, kind))
