"""What joins interfaces: segments of bridges, and radio channels on which not all hear each other."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from functools import partial
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


class Bridge:
    """A learning bridge: a frame goes where its receiver was last heard, or everywhere but back."""

    def __init__(self) -> None:
        self.ports: list[Deliver] = []
        self.open: list[bool] = []
        """which ports carry frames: those of the spanning tree"""
        self._learnt: dict[bytes, int] = {}

    def add(self, send: Deliver) -> None:
        self.ports.append(send)
        self.open.append(True)

    def receive(self, port: int, frame: bytes, now: float) -> None:
        """A frame came in by that port."""
        if not self.open[port]:
            return
        to, sender = frame[:6], frame[6:12]
        self._learnt[sender] = port
        known = None if to[0] & _GROUP else self._learnt.get(to)
        if known is not None:
            if known != port:
                self.ports[known](frame, now)
            return
        for number, send in enumerate(self.ports):
            if number != port and self.open[number]:
                send(frame, now)

    def forget(self) -> None:
        """The tree has changed: who is where is learnt again."""
        self._learnt.clear()


class Hop:
    """The two channels between two bridges, and the port each has for it."""

    def __init__(self, ends: tuple[str, str], ports: tuple[int, int], channels: tuple[Channel, Channel]) -> None:
        self.ends, self.ports, self.channels = ends, ports, channels

    @property
    def up(self) -> bool:
        return all(channel.conditions.up for channel in self.channels)


class Segment:
    """Bridges with radio hops between them and interfaces behind them: one layer 2, as WDS makes it.

    Where hops form a loop, some carry nothing: the tree is that of the fewest hops from the first bridge of each part
    that hangs together. It is found again at once when a hop goes down or comes back; a real spanning tree protocol
    takes a second or more. A hop that is cut in one direction carries nothing: its bridges no longer hear each other.
    """

    def __init__(self, behind: Mapping[str, Sequence[Tap]], shared: bool) -> None:
        self.bridges = {name: Bridge() for name in behind}
        self._shared = shared
        self.hops: list[Hop] = []
        self._tree: set[int] | None = None
        """the hops that carry frames"""
        for name, bridge in self.bridges.items():
            for tap in behind[name]:
                tap.send = partial(bridge.receive, len(bridge.ports))
                bridge.add(tap.receive)

    def add(self, a: str, b: str, ab: int, ba: int, make: MakeChannel) -> None:
        """A hop between two bridges."""
        one, other, air = self.bridges[a], self.bridges[b], Air()
        there = make(ab, air, partial(other.receive, len(other.ports)))
        back = make(ba, air if self._shared else Air(), partial(one.receive, len(one.ports)))
        self.hops.append(Hop((a, b), (len(one.ports), len(other.ports)), (there, back)))
        one.add(there.send)
        other.add(back.send)

    def changed(self) -> None:
        """Find the tree among the hops that are up."""
        used: set[int] = set()
        reached: set[str] = set()
        for root in self.bridges:
            if root in reached:
                continue
            reached.add(root)
            edge = [root]
            while edge:
                at = edge.pop(0)
                for number, hop in enumerate(self.hops):
                    if at not in hop.ends or not hop.up:
                        continue
                    there = hop.ends[1] if hop.ends[0] == at else hop.ends[0]
                    if there not in reached:
                        reached.add(there)
                        used.add(number)
                        edge.append(there)
        if used == self._tree:
            return
        self._tree = used
        for number, hop in enumerate(self.hops):
            for end, port in zip(hop.ends, hop.ports, strict=True):
                self.bridges[end].open[port] = number in used
        for bridge in self.bridges.values():
            bridge.forget()


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
