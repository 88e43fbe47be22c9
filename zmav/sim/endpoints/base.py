"""What every endpoint has: the vehicle behind it, and the world that serves it."""

from __future__ import annotations

import selectors
from collections.abc import Callable
from typing import NamedTuple, Protocol

from zmav.sim.protocol.channel import Channel, Outlet

BACKLOG_BYTES = 64 * 1024  # what a client that does not read may leave standing
READ_BYTES = 65536
READS_PER_TURN = 16  # so that a flood on one link does not starve the others


class Switchboard(Protocol):
    """The vehicle behind an endpoint."""

    def open_channel(self, outlet: Outlet, link: str = "") -> Channel: ...

    def close_channel(self, channel: Channel) -> None: ...

    def receive(self, channel: Channel, data: bytes) -> None: ...


class Flushed(Protocol):
    """Holds what is to be sent."""

    def flush(self) -> bool:
        """Send what can be sent now; True where nothing is left to do."""


class Wiring(NamedTuple):
    """What the world does for its endpoints. ``selector`` calls each key's ``data`` when it is ready; everything in
    ``waiting`` is flushed after each tick until it has nothing left; ``now`` gives simulated seconds.
    """

    selector: selectors.BaseSelector
    waiting: set[Flushed]
    now: Callable[[], float]


class Endpoint(Protocol):
    """A way to reach one vehicle; all methods are called in the world's thread (or before it runs)."""

    url: str
    link: str
    """its kind, which its channels are called by"""

    def clients(self) -> int:
        """How many are known to be at the other end."""

    def close(self) -> None: ...
