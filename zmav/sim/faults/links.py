"""Links that lose, delay, repeat or garble frames: the vehicle's own radio, in front of its sockets.

Every frame is treated by itself in both directions; connections stay open, as a radio out of range leaves a serial
port or a socket open.
"""

from __future__ import annotations

import heapq
import random
from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from zmav.errors import BadInput
from zmav.mavlink.codec import decode
from zmav.mavlink.frames import Splitter
from zmav.sim.faults.base import Fault, Undo, Victim
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Channel, Outlet, Part

Direction = Literal["both", "down", "up"]
Link = Literal["all", "tcp", "serial0", "serial1", "serial2", "udp", "udp-listen", "pty", "onboard", "ground"]
Percent = Annotated[float, Meta(ge=0.0, le=100.0)]
Milliseconds = Annotated[float, Meta(ge=0.0, le=600_000.0)]
_SYNONYMS = {"tcp": "serial0", "serial0": "tcp"}
MOST_WAITING = 20_000  # frames that a delay keeps; what is more is lost


class LinkFault(Fault, frozen=True):
    """Base of what happens to frames. ``direction``: "down" from the vehicle, "up" to it, or "both"; ``link``: those
    of one kind of endpoint (:mod:`zmav.sim.endpoints`).
    """

    direction: Direction = "both"
    link: Link = "all"

    def check(self, victim: Victim) -> None:
        there = [endpoint.link for endpoint in victim.vehicle.endpoints]
        if there and not any(self.concerns(link, self.direction) for link in there):
            expected = ", ".join(("all", *there))
            raise BadInput(
                f"{victim.name} has no link {self.link!r}; there are {expected}",
                field="link",
                value=self.link,
                expected=expected,
            )

    def begin(self, victim: Victim) -> Undo:
        weather = weather_of(victim.vehicle.node)
        weather.put(self, random.Random(victim.seed))
        return lambda: weather.take(self)

    def concerns(self, link: str, direction: str) -> bool:
        return self.direction in ("both", direction) and self.link in ("all", link, _SYNONYMS.get(link))

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        """What arrives of a frame, and how many seconds later."""
        raise NotImplementedError


class LinkCut(LinkFault, frozen=True):
    """Nothing passes."""

    KIND: ClassVar[str] = "link-cut"

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        return []


class LinkLoss(LinkFault, frozen=True):
    """So many percent of the frames are lost."""

    KIND: ClassVar[str] = "link-loss"
    percent: Percent = 20.0

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        return [] if chance.random() * 100.0 < self.percent else [(0.0, data)]


class LinkDelay(LinkFault, frozen=True):
    """Frames come so many milliseconds later, give or take jitter_ms (evenly); with jitter they overtake each other."""

    KIND: ClassVar[str] = "link-delay"
    ms: Milliseconds = 200.0
    jitter_ms: Milliseconds = 0.0

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        late = self.ms + (chance.uniform(-self.jitter_ms, self.jitter_ms) if self.jitter_ms else 0.0)
        return [(max(late, 0.0) / 1000.0, data)]


class LinkDuplication(LinkFault, frozen=True):
    """So many percent of the frames come twice."""

    KIND: ClassVar[str] = "link-duplication"
    percent: Percent = 20.0

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        return [(0.0, data)] * (2 if chance.random() * 100.0 < self.percent else 1)


class LinkCorruption(LinkFault, frozen=True):
    """Of so many percent of the frames one bit is wrong."""

    KIND: ClassVar[str] = "link-corruption"
    percent: Percent = 10.0

    def travel(self, data: bytes, chance: random.Random) -> list[tuple[float, bytes]]:
        if chance.random() * 100.0 >= self.percent:
            return [(0.0, data)]
        garbled = bytearray(data)
        garbled[chance.randrange(len(garbled))] ^= 1 << chance.randrange(8)
        return [(0.0, bytes(garbled))]


class Weather(Part):
    """What one vehicle's links go through now. Where there is nothing, frames go as if it were not there."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._now = node.brain.now
        self._faults: list[tuple[LinkFault, random.Random]] = []
        self._waiting: list[tuple[float, int, Channel, str, bytes]] = []
        self._count = 0
        for channel in node.channels:
            self.opened(channel)

    def put(self, fault: LinkFault, chance: random.Random) -> None:
        self._faults.append((fault, chance))

    def take(self, fault: LinkFault) -> None:
        self._faults = [pair for pair in self._faults if pair[0] is not fault]

    # ---- as a part of the node

    def opened(self, channel: Channel) -> None:
        line = channel.outlet
        channel.outlet = Air(self, channel, line)
        channel.beneath = lambda: None if self._cut(channel.link) else line
        splitter, timesync = Splitter(self._node.dialect), self._node.dialect.message("TIMESYNC").id

        def incoming(data: bytes) -> None:
            if not self._faults and not self._waiting:
                self._node.take(channel, data)
                return
            for frame in splitter.feed(data):
                if frame.msgid == timesync and decode(frame, self._node.dialect)["tc1"] != 0:
                    self._node.take(channel, frame.data)  # an answer to lock step
                else:
                    self.carry(channel, "up", frame.data)

        channel.incoming = incoming

    def closed(self, channel: Channel) -> None:
        self._waiting = [entry for entry in self._waiting if entry[2] is not channel]
        heapq.heapify(self._waiting)

    def tick(self, now: float) -> None:
        self._now = now
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            _, _, channel, direction, data = heapq.heappop(self._waiting)
            self._deliver(channel, direction, data)

    def _cut(self, link: str) -> bool:
        cuts = [fault for fault, _ in self._faults if isinstance(fault, LinkCut)]
        return any(cut.concerns(link, direction) for cut in cuts for direction in ("down", "up"))

    # ---- frames on their way

    @property
    def clear(self) -> bool:
        """Nothing happens to frames, and none is on its way."""
        return not self._faults and not self._waiting

    def carry(self, channel: Channel, direction: str, data: bytes) -> None:
        """Send one frame on its way."""
        arriving = [(0.0, data)]
        for fault, chance in self._faults:
            if fault.concerns(channel.link, direction):
                arriving = [(late + more, kept) for late, sent in arriving for more, kept in fault.travel(sent, chance)]
        for late, kept in arriving:
            if late <= 0.0:
                self._deliver(channel, direction, kept)
            elif len(self._waiting) < MOST_WAITING:
                self._count += 1
                heapq.heappush(self._waiting, (self._now + late, self._count, channel, direction, kept))

    def _deliver(self, channel: Channel, direction: str, data: bytes) -> None:
        if direction == "up":
            self._node.take(channel, data)
        elif isinstance(channel.outlet, Air):
            channel.outlet.arrive(data)


class Air:
    """A channel's way out, by way of the weather."""

    def __init__(self, weather: Weather, channel: Channel, outlet: Outlet) -> None:
        self._weather = weather
        self._channel = channel
        self._outlet = outlet

    def room(self) -> int:
        return self._outlet.room()

    def put(self, frame: bytes) -> None:
        if self._weather.clear:
            self._outlet.put(frame)
        else:
            self._weather.carry(self._channel, "down", frame)

    def arrive(self, frame: bytes) -> None:
        """A frame has come through; where the line is full it is lost."""
        if self._outlet.room() >= len(frame):
            self._outlet.put(frame)


def weather_of(node: Node) -> Weather:
    """What the node's links go through; there is one from the first fault on."""
    for part in node.parts:
        if isinstance(part, Weather):
            return part
    weather = Weather(node)
    node.add(weather)
    return weather
