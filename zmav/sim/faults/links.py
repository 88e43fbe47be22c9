"""Links that lose frames: the vehicle's own radio, in front of its sockets.

Every frame is treated by itself in both directions; connections stay open, as a radio out of range leaves a serial
port or a socket open.
"""

from __future__ import annotations

import random
from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from zmav.mavlink.codec import decode
from zmav.mavlink.frames import Splitter
from zmav.sim.faults.base import AutopilotFault, Undo, Victim
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Channel, Outlet, Part


class LinkCut(AutopilotFault, frozen=True):
    """Nothing passes."""

    KIND: ClassVar[str] = "link-cut"
    direction: Literal["both", "down", "up"] = "both"
    """"down" from the vehicle, "up" to it"""

    def begin(self, victim: Victim) -> Undo:
        weather = weather_of(victim.vehicle.node)
        entry = (self, random.Random(victim.seed))
        weather.faults.append(entry)
        return lambda: weather.faults.remove(entry)

    def loses(self, direction: str, chance: random.Random) -> bool:
        """Whether it takes a frame on its way ``direction``."""
        return self.direction in ("both", direction)


class LinkLoss(LinkCut, frozen=True):
    """So many percent of the frames are lost."""

    KIND: ClassVar[str] = "link-loss"
    percent: Annotated[float, Meta(ge=0.0, le=100.0)] = 20.0

    def loses(self, direction: str, chance: random.Random) -> bool:
        return super().loses(direction, chance) and chance.random() * 100.0 < self.percent


class Weather(Part):
    """What one vehicle's links go through now. Where there is nothing, frames go as if it were not there."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.faults: list[tuple[LinkCut, random.Random]] = []
        for channel in node.channels:
            self.opened(channel)

    def opened(self, channel: Channel) -> None:
        line = channel.outlet
        channel.outlet = Air(self, line)
        channel.beneath = lambda: None if any(type(fault) is LinkCut for fault, _ in self.faults) else line
        splitter, timesync = Splitter(self._node.dialect), self._node.dialect.message("TIMESYNC").id

        def incoming(data: bytes) -> None:
            if not self.faults:
                self._node.take(channel, data)
                return
            for frame in splitter.feed(data):
                # An answer to lock step always passes.
                if (frame.msgid == timesync and decode(frame, self._node.dialect)["tc1"] != 0) or self.pass_on("up"):
                    self._node.take(channel, frame.data)

        channel.incoming = incoming

    def pass_on(self, direction: str) -> bool:
        """Whether a frame gets through."""
        return not any(fault.loses(direction, chance) for fault, chance in self.faults)


class Air:
    """A channel's way out, by way of the weather."""

    def __init__(self, weather: Weather, outlet: Outlet) -> None:
        self._weather = weather
        self._outlet = outlet

    def room(self) -> int:
        return self._outlet.room()

    def put(self, frame: bytes) -> None:
        if self._weather.pass_on("down"):
            self._outlet.put(frame)


def weather_of(node: Node) -> Weather:
    """What the node's links go through; there is one from the first fault on."""
    for part in node.parts:
        if isinstance(part, Weather):
            return part
    weather = Weather(node)
    node.add(weather)
    return weather
