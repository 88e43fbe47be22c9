"""A stream as it was asked for, and what became of it, seen from both ends."""

from __future__ import annotations

import msgspec

from zmav.wire.bench import BenchClock, BenchInterval, BenchOutage, BenchQos, BenchReport, BenchTrip, Spread


class Stream(msgspec.Struct, kw_only=True, frozen=True):
    """What is sent."""

    seconds: float = 20.0
    hz: float = 125.0
    size: int = 1000
    qos: BenchQos = "latest-wins"
    guard: float = 2.0
    """Hz of realtime queries beside it, which also compare the clocks"""
    patience: float = 8.0

    @property
    def silence(self) -> float:
        """s without a datagram that are an outage: five datagrams' time, and 0.2 s at least."""
        return min(max(5.0 / self.hz, 0.2), 60.0)

    @property
    def bits(self) -> float:
        """Of payload a second."""
        return self.hz * self.size * 8.0


class Flow(msgspec.Struct, kw_only=True):
    """A stream as far as it is known."""

    stream: Stream
    source: str
    target: str
    sender: BenchReport
    receiver: BenchReport
    intervals: list[BenchInterval] = []
    outages: list[BenchOutage] = []
    faults: list[str] = []
    """what went wrong, in words"""

    @property
    def clock(self) -> BenchClock | None:
        """The target's clock less the source's."""
        return self.sender.clock

    @property
    def total(self) -> BenchInterval:
        """The whole run; what was sent and never came is lost, the last datagrams too."""
        found = self.receiver.total or BenchInterval(
            start=0.0, end=self.sender.send_seconds, bytes=0, received=0, expected=0, jitter=0.0, out_of_order=0
        )
        return msgspec.structs.replace(found, expected=max(self.sender.sent, found.received))

    @property
    def bandwidth(self) -> float:
        """bit/s of payload that came."""
        total = self.total
        return 8.0 * total.bytes / total.end if total.end > 0 else 0.0

    @property
    def loss(self) -> float:
        """0 to 1."""
        total = self.total
        return total.lost / total.expected if total.expected else 0.0

    def delay(self, transit: Spread | None) -> tuple[float, float] | None:
        """One-way delay's median and p99 in s: as wrong as ``clock.within`` says."""
        if transit is None or self.clock is None:
            return None
        return transit.median - self.clock.offset, transit.p99 - self.clock.offset

    @property
    def idle(self) -> BenchTrip | None:
        """Round trips of the realtime class just before."""
        return self._trip(0)

    @property
    def loaded(self) -> BenchTrip | None:
        """Round trips of the realtime class beside the stream."""
        return self._trip(1)

    def _trip(self, place: int) -> BenchTrip | None:
        trips = self.sender.trips
        return trips[place] if place < len(trips) else None
