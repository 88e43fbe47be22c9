"""A microservice as a part that any autopilot's node can have: parameters, missions, files, logs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from zmav.sim.protocol.channel import Channel

Sender = tuple[int, int]
"""(system id, component id) of who sent a message"""

Answer = Callable[[Channel, dict[str, Any], Sender], None]


class Part:
    """One microservice of one vehicle; everything is called in the world's thread.

    A node takes it with :meth:`zmav.sim.protocol.base.Node.add`.
    """

    due = -math.inf
    """when :meth:`tick` has something to do next, simulated seconds; a part that sets it is called then, not before"""

    def answers(self) -> Mapping[str, Answer]:
        """Who answers which message, by the message's name."""
        return {}

    def tick(self, now: float) -> None:
        """Called at every tick, after the streams were sent; ``now``: simulated seconds."""

    def opened(self, channel: Channel) -> None:
        """``channel`` is new: it is among the node's channels, and nothing has been heard on it."""

    def closed(self, channel: Channel) -> None:
        """``channel`` is gone: end what went on there."""
