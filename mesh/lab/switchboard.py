"""What the relay has: namespaces, interfaces and media as the lab described them, and its answers to the lab."""

from __future__ import annotations

import resource
import time

from mesh.lab import kernel, messages
from mesh.lab.channel import Agenda, Air, Channel, Deliver
from mesh.lab.media import Ether, Segment, Tap, join
from mesh.lab.pcap import Capture


class RelayNetwork:
    """Makes everything; raises :class:`OSError` where the kernel refuses. The caller's thread ends up in a namespace of
    its own, without interfaces.
    """

    def __init__(self, begin: messages.Begin) -> None:
        self.agenda = Agenda()
        self._begin, self._captures = begin, dict[str, Capture]()
        self._channels: dict[int, Channel] = {}
        self.networks: list[int] = []
        """a descriptor of each host's namespace"""
        self.taps: list[Tap] = []
        by_host: dict[int, list[int]] = {}
        for number, spec in enumerate(begin.taps):
            by_host.setdefault(spec.host, []).append(number)
        made: dict[int, Tap] = {}
        for host in range(begin.hosts):
            kernel.unshare(kernel.CLONE_NEWNET)
            kernel.without_ipv6()
            kernel.bring_up("lo")
            self.networks.append(kernel.network_of_this_thread())
            made.update((number, _tap(begin.taps[number])) for number in by_host.get(host, []))
        kernel.unshare(kernel.CLONE_NEWNET)
        self.taps = [made[number] for number in range(len(begin.taps))]
        self._changing: list[Segment | Ether] = []
        for medium in begin.media:
            self._add(medium)
        self._settle()

    def _make(self, number: int, air: Air, deliver: Deliver) -> Channel:
        conditions = self._begin.channels[number]
        made = Channel(conditions, air, self.agenda, deliver, seed=self._begin.seed * 1_000_003 + number)
        self._channels[number] = made
        return made

    def _add(self, spec: messages.LinkSpec | messages.SegmentSpec | messages.EtherSpec) -> None:
        if isinstance(spec, messages.LinkSpec):
            pair = spec.pair
            join(self.taps[pair.a], self.taps[pair.b], pair.ab, pair.ba, spec.shared, self._make)
        elif isinstance(spec, messages.SegmentSpec):
            segment = Segment([[self.taps[number] for number in taps] for taps in spec.behind])
            for hop in spec.hops:
                segment.add_hop(hop.a, hop.b, hop.ab, hop.ba, spec.shared, self._make)
            self._changing.append(segment)
        else:
            ether = Ether([self.taps[number] for number in spec.taps], spec.shared)
            for pair in spec.pairs:
                ether.add_pair(pair.a, pair.b, pair.ab, pair.ba, self._make)
            self._changing.append(ether)

    def _settle(self) -> None:
        for medium in self._changing:
            medium.changed()

    def answer(self, request: messages.Request) -> messages.Answer:
        """Do what the lab asks."""
        if isinstance(request, messages.Set):
            now = time.monotonic()
            for number, conditions in request.channels.items():
                self._channels[number].set(conditions, now)
            self._settle()
            return messages.Done()
        if isinstance(request, messages.AskCounters):
            return self._counted()
        if isinstance(request, messages.Record):
            return self._record(request)
        return messages.Failed(0, f"{type(request).__name__} comes first and once")

    def _counted(self) -> messages.Counted:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return messages.Counted(
            channels=[self._channels[number].counters for number in range(len(self._channels))],
            refused=[tap.refused for tap in self.taps],
            cpu_s=usage.ru_utime + usage.ru_stime,
            under_way=len(self.agenda),
        )

    def _record(self, request: messages.Record) -> messages.Answer:
        before = self._captures.pop(request.path, None)
        if before is not None:
            for channel in self._channels.values():
                if channel.capture == before.add:
                    channel.capture = None
            before.close()
        if not request.channels:
            return messages.Failed(0, before.failed) if before and before.failed else messages.Done()
        try:
            capture = Capture(request.path)
        except OSError as e:
            return messages.Failed(e.errno or 0, f"{request.path}: {e.strerror}")
        except ValueError as e:  # a zero byte in the path
            return messages.Failed(0, f"{request.path!r}: {e}")
        self._captures[request.path] = capture
        for number in request.channels:
            self._channels[number].capture = capture.add
        return messages.Done()


def _tap(spec: messages.TapSpec) -> Tap:
    fd = kernel.open_tap(spec.name, mac=spec.mac, address=spec.address, prefix=spec.prefix, mtu=spec.mtu)
    return Tap(fd, spec.mac, kernel.largest_frame(spec.mtu))
