"""MAVLink 2 signing as ArduPilot does it: SETUP_SIGNING sets the key for all links, and the first link stays open.

https://mavlink.io/en/guide/message_signing.html; which links and messages: ArduPilot's GCS_Signing.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zmav.mavlink.signing import TICKS, Signing, SigningClock
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.channel import Answer, Channel, Part, Sender

WARNING = 4


class SigningPart(Part):
    """Keeps the key of one vehicle, through its reboots."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clock = SigningClock(now=lambda: node.unix_us / 1e6)
        self._key: bytes | None = None

    def answers(self) -> Mapping[str, Answer]:
        return {"SETUP_SIGNING": self._setup}

    def opened(self, channel: Channel) -> None:
        self._apply(channel)

    def _setup(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if self._node.brain.armed:
            self._node.say(WARNING, "ERROR: Won't setup signing when armed")
            return
        key = bytes(msg["secret_key"])
        off = not any(key) and msg["initial_timestamp"] == 0
        self._key = None if off else key
        self._clock.heard(msg["initial_timestamp"] + 60 * TICKS)
        for each in self._node.channels:
            self._apply(each)

    def _apply(self, channel: Channel) -> None:
        if self._key is None:
            channel.signing = None
            return
        number = self._node.channels.index(channel)
        unsigned = "accept" if number == 0 else "refuse"  # the first is taken for a USB cable
        channel.signing = Signing(self._key, self._node.dialect, link_id=number, clock=self._clock, unsigned=unsigned)
