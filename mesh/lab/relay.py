"""The lab's one process that holds all namespaces and moves all frames: ``python -m mesh.lab.relay FD``.

It is the first process of a PID namespace in which everything else of the lab runs. So when it ends, for whatever
reason, the kernel kills all of that; with its descriptors go the interfaces and the network namespaces; and it ends
when the lab's end of its socket closes, which the kernel does however the lab ends. Nothing has a name in the system.

It imports little, and a single thread does everything: frames are few (thousands a second) and their order matters.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import resource
import select
import shutil
import signal
import sys
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mesh.lab import kernel, messages
from mesh.lab.channel import Agenda, Air, Channel, Deliver

_GROUP = 0x01  # of a MAC address's first byte: broadcast and multicast
# What the kernel says of a frame that no interface takes: it is down, deleted, or its queue is full.
_NOT_TAKEN = (errno.EIO, errno.EBADFD, errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM)


MakeChannel = Callable[[int, Air, Deliver], Channel]
"""makes the channel of that number, which has the conditions that the lab gave it"""


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


EARLY_S = 50e-6
"""a frame that is due so soon arrives now: to be woken once more for it would cost as much"""


class RelayNetwork:
    """Makes everything; raises :class:`OSError` where the kernel refuses. The caller's thread ends up in a namespace of
    its own, without interfaces.
    """

    def __init__(self, begin: messages.Begin) -> None:
        self.agenda = Agenda()
        self._begin = begin
        self._channels: dict[int, Channel] = {}
        self.networks: list[int] = []
        """a descriptor of each host's namespace"""
        self.taps: list[Tap] = []
        self._media: list[Ether] = []
        by_place: dict[tuple[str, str], Tap] = {}
        for host in begin.hosts:
            kernel.unshare(kernel.CLONE_NEWNET)
            kernel.without_ipv6()
            kernel.bring_up("lo")
            self.networks.append(kernel.network_of_this_thread())
            for each in begin.interfaces:
                if each.host == host:
                    by_place[host, each.medium] = _tap(each)
        kernel.unshare(kernel.CLONE_NEWNET)
        self.taps = list(by_place.values())
        for medium in begin.media:
            ether = Ether({host: tap for (host, name), tap in by_place.items() if name == medium.name}, medium.shared)
            for edge in begin.edges:
                if edge.medium == medium.name:
                    ether.add(edge.a, edge.b, edge.ab, edge.ba, self._make)
            self._media.append(ether)
        self._settle()

    def _make(self, number: int, air: Air, deliver: Deliver) -> Channel:
        conditions, seed = self._begin.channels[number], self._begin.seed * 1_000_003 + number
        made = self._channels[number] = Channel(conditions, air, self.agenda, deliver, seed=seed)
        return made

    def _settle(self) -> None:
        for medium in self._media:
            medium.changed()

    def answer(self, request: messages.Set) -> messages.Counted:
        """Do what the lab asks."""
        now = time.monotonic()
        for number, conditions in request.channels.items():
            self._channels[number].set(conditions, now)
        self._settle()
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return messages.Counted(
            channels=[self._channels[number].counters for number in range(len(self._channels))],
            cpu_s=usage.ru_utime + usage.ru_stime,
            under_way=len(self.agenda),
        )


def _tap(each: messages.Interface) -> Tap:
    fd = kernel.open_tap(each.name, mac=each.mac, address=each.address, prefix=each.prefix, mtu=each.mtu)
    return Tap(fd, each.mac, kernel.largest_frame(each.mtu))


def main() -> None:
    """Become the first process of a new PID namespace and serve the lab on the socket ``argv[1]``."""
    kernel.unshare(kernel.CLONE_NEWPID)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # two for each host, and one for each interface
    gc.disable()  # nothing here makes cycles, and frames come by the million
    child = os.fork()
    if child:
        os.close(int(sys.argv[1]))
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    kernel.die_with_parent(signal.SIGKILL)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # orphans of the PID namespace become our children
    with Connection(int(sys.argv[1])) as lab, contextlib.suppress(EOFError, ConnectionError):
        serve(lab)


def serve(lab: Connection[Any, Any]) -> None:
    """Do what the lab says until it has gone (:class:`EOFError`); then leave nothing behind."""
    begin = lab.recv()
    assert isinstance(begin, messages.Begin)
    try:
        network = RelayNetwork(begin)
        pid = int(str(Path("/proc/self").readlink()))  # as those outside our PID namespace call us: /proc is theirs
        lab.send(messages.Begun(pid, network.networks))
        run(lab, network)
    except OSError as e:
        lab.send(e)
    finally:
        if os.getpid() == 1:  # in a PID namespace of our own, and so these are all in it: nobody writes any more
            with contextlib.suppress(OSError):
                os.kill(-1, signal.SIGKILL)
        for directory in begin.directories:
            shutil.rmtree(directory, ignore_errors=True)


def run(lab: Connection[Any, Any], network: RelayNetwork) -> None:
    """Move frames and answer the lab, for ever."""
    timer, poll, armed = kernel.Timer(), select.epoll(), 0.0
    taps = {tap.fd: tap for tap in network.taps}
    for fd in (lab.fileno(), timer.fd, *taps):
        poll.register(fd, select.EPOLLIN)
    agenda, monotonic, read = network.agenda, time.monotonic, os.read
    while True:
        due = agenda.next()
        if due is not None and due != armed:
            timer.arm(due)
            armed = due
        for fd, _ in poll.poll():
            tap = taps.get(fd)
            if tap is not None:
                # One frame and no more: to learn that there is none costs an exception, dearer than being told again.
                try:
                    tap.send(read(fd, tap.largest), monotonic())
                except BlockingIOError:
                    pass
                except OSError:  # somebody deleted the interface in its namespace
                    poll.unregister(fd)
            elif fd != timer.fd:
                lab.send(network.answer(lab.recv()))
        agenda.run(monotonic() + EARLY_S)
        if agenda.next() is None and armed:
            timer.disarm()
            armed = 0.0


if __name__ == "__main__":
    main()
