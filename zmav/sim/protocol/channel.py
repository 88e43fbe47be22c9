"""A channel: one MAVLink link of one autopilot, with its own sequence numbers and stream rates; what
comes by it: commands, and messages for microservices.

Real autopilots count sequence numbers per link, not per message source, and put a frame on a link only where it has
room; a link that nobody reads loses whole messages and never holds anything up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec

from zmav.mavlink.codec import Packer
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Splitter
from zmav.mavlink.signing import Signing
from zmav.sim.protocol.streams import Streams

LARGEST_FRAME = 280


class Outlet(Protocol):
    """Where a channel's frames go."""

    def room(self) -> int:
        """Bytes that can be taken now."""

    def put(self, frame: bytes) -> None:
        """Take one frame; never blocks."""


class Channel:
    """One link: frames in through ``splitter``, frames out with :meth:`send`. ``link`` names it, where an autopilot
    tells its links apart.
    """

    def __init__(self, dialect: Dialect, outlet: Outlet, sysid: int, compid: int, now: float, link: str = "") -> None:
        self.link = link
        self.streams = Streams(now)
        self.splitter = Splitter(dialect)
        self.outlet = outlet
        self.beneath: Callable[[], Outlet | None] = lambda: self.outlet
        """where frames go past all faults of the link; None: nothing passes at all"""
        self.dropped = 0
        self.sent = 0
        self.params_next: int | None = None  # index of the next parameter of a running download
        self.signing: Signing | None = None
        self.incoming: Callable[[bytes], None] | None = None
        """takes what comes in, before anybody understands it; None: nobody stands between"""
        self._packer = Packer(dialect, sysid, compid)

    def restart(self, now: float) -> None:
        """The autopilot has started again: it counts from 0, and sends what nobody has to ask for."""
        self._packer.restart()
        self.streams = Streams(now)
        self.params_next = None

    def adopt(self, sysid: int) -> None:
        """Speak with another system id from now on."""
        self._packer.sysid = sysid

    def has_room(self, frames: int = 1) -> bool:
        return self.outlet.room() >= frames * LARGEST_FRAME

    def send(self, name: str, /, **fields: Any) -> bool:
        """Send one message; False (and counted) where the link has no room for it."""
        if not self.has_room():
            self.dropped += 1
            return False
        frame = self._packer.pack(name, **fields)
        self.outlet.put(frame if self.signing is None else self.signing.sign(frame))
        self.sent += 1
        return True

    def ask(self, question: int) -> bool:
        """Lock step's question for the time (TIMESYNC): it is the simulator's, and no link's weather is in its way.
        False where nobody will hear it.
        """
        outlet = self.beneath()
        if outlet is None or outlet.room() < LARGEST_FRAME:
            return False
        frame = self._packer.pack("TIMESYNC", tc1=0, ts1=question)
        outlet.put(frame if self.signing is None else self.signing.sign(frame))
        return True

    def acknowledge(self, command: int, result: int, to: tuple[int, int]) -> None:
        """COMMAND_ACK to the (system, component) that gave the command."""
        self.send("COMMAND_ACK", command=command, result=result, target_system=to[0], target_component=to[1])

    def forward(self, data: bytes) -> None:
        """Pass on somebody else's frame, untouched."""
        if self.has_room():
            self.outlet.put(data)


# ---- microservices

Sender = tuple[int, int]
"""(system id, component id) of who sent a message"""

Answer = Callable[[Channel, dict[str, Any], Sender], None]


class Part:
    """One microservice of one vehicle; everything is called in the world's thread.

    A node takes it with :meth:`zmav.sim.protocol.base.Node.add`.
    """

    due = -math.inf
    """when :meth:`tick` has something to do next, simulated seconds; a part that sets it is called then, not before"""

    @property
    def sending(self) -> bool:
        """The next tick goes on with something long: such ticks do not wait for each other."""
        return False

    def answers(self) -> Mapping[str, Answer]:
        """Who answers which message, by the message's name."""
        return {}

    def tick(self, now: float) -> None:
        """Called at every tick, after the streams were sent; ``now``: simulated seconds."""

    def opened(self, channel: Channel) -> None:
        """``channel`` is new: it is among the node's channels, and nothing has been heard on it."""

    def closed(self, channel: Channel) -> None:
        """``channel`` is gone: end what went on there."""


# ---- commands: https://mavlink.io/en/services/command.html

FORCE = 21196  # param2 of arming that skips the checks, and of disarming in flight
CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
CHANGE_MODE = 1  # MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
RELATIVE_ALT = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT, which a COMMAND_LONG is taken to mean
_NO_PLACE = 2**31 - 1  # x and y of a COMMAND_INT that names none


class Command(msgspec.Struct, frozen=True):
    """COMMAND_LONG or COMMAND_INT: ``x`` and ``y`` as they came; ``sender`` is who asked, on ``channel``."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    x: float
    y: float
    z: float
    frame: int
    as_int: bool
    channel: Channel
    sender: Sender

    @property
    def degrees(self) -> tuple[float, float]:
        """Latitude and longitude; NaN where not given."""
        if not self.as_int:
            return self.x, self.y
        return (math.nan, math.nan) if self.x == self.y == _NO_PLACE else (self.x * 1e-7, self.y * 1e-7)


def read_command(msg: dict[str, Any], channel: Channel, sender: Sender) -> Command:
    """The command of a message of either form."""
    as_int = "x" in msg
    x, y, z = (msg[name] for name in (("x", "y", "z") if as_int else ("param5", "param6", "param7")))
    p1, p2, p3, p4 = (msg[f"param{i}"] for i in range(1, 5))
    frame = msg.get("frame", RELATIVE_ALT)
    return Command(msg["command"], p1, p2, p3, p4, x, y, z, frame, as_int, channel, sender)
