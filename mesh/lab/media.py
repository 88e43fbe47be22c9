"""What joins interfaces: radio channels on which not all hear each other."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from typing import Protocol

from mesh.lab.channel import Air, Channel, Deliver

_GROUP = 0x01  # of a MAC address's first byte: broadcast and multicast
# What the kernel says of a frame that no interface takes: it is down, deleted, or its queue is full.
_NOT_TAKEN = (errno.EIO, errno.EBADFD, errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM)


class MakeChannel(Protocol):
    """Makes the channel of that number, which has the conditions the lab gave it."""

    def __call__(self, number: int, air: Air, deliver: Deliver) -> Channel: ...


class Tap:
    """The lab's end of a host's interface."""

    def __init__(self, fd: int, mac: bytes, largest: int) -> None:
        self.fd, self.mac, self.largest = fd, mac, largest
        self.send: Deliver = self._nowhere
        """where the host's frames go; the medium sets it"""

    def _nowhere(self, frame: bytes, now: float) -> None:
        return

    def receive(self, frame: bytes, now: float) -> None:
        """Give the host a frame."""
        try:
            os.write(self.fd, frame)
        except OSError as e:
            if e.errno not in _NOT_TAKEN:
                raise


class Station:
    """One interface on a radio channel: whom it reaches, and the air it sends on."""

    def __init__(self, tap: Tap, air: Air) -> None:
        self.tap, self.air = tap, air
        self.to: dict[bytes, Channel] = {}
        self._heard: list[Channel] = []
        tap.send = self._send

    def changed(self) -> None:
        """Conditions have changed: see who hears us."""
        self._heard = [channel for channel in self.to.values() if channel.conditions.up]

    def _send(self, frame: bytes, now: float) -> None:
        if not frame[0] & _GROUP:
            channel = self.to.get(frame[:6])
            if channel is not None:
                channel.send(frame, now)
            return
        if not self._heard:
            return
        # To all at once, at the rate of the slowest, as radios do it.
        slowest = min(self._heard, key=_rate).conditions
        left = self.air.admit(len(frame), slowest.rate, slowest, now)
        for channel in self._heard:
            counters = channel.counters
            counters.frames += 1
            counters.bytes += len(frame)
            if left is None:
                counters.queue_full += 1
            else:
                channel.carry(frame, left, now)


def _rate(channel: Channel) -> float:
    rate = channel.conditions.rate
    return float("inf") if rate is None else rate


class Ether:
    """A radio channel: each pair of stations has its own conditions, and those that are not up do not hear each other.

    ``shared``: one sends at a time, and all wait for it, hidden or not; else each has its own share of the air. That
    two speak at once and destroy each other's frames does not happen here: what that costs is part of ``loss``.
    """

    def __init__(self, taps: Mapping[str, Tap], shared: bool) -> None:
        air = Air()
        self.stations = {host: Station(tap, air if shared else Air()) for host, tap in taps.items()}

    def add(self, a: str, b: str, ab: int, ba: int, make: MakeChannel) -> None:
        """Two that may hear each other."""
        one, other = self.stations[a], self.stations[b]
        one.to[other.tap.mac] = make(ab, one.air, other.tap.receive)
        other.to[one.tap.mac] = make(ba, other.air, one.tap.receive)

    def changed(self) -> None:
        for station in self.stations.values():
            station.changed()
