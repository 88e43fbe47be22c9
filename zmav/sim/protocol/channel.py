"""A channel: one MAVLink link of one autopilot, with its own sequence numbers and its own stream rates.

Real autopilots count sequence numbers per link, not per message source, and put a frame on a link only where it has
room; a link that nobody reads loses whole messages and never holds anything up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

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
