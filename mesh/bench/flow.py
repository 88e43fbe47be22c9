"""A stream as it was asked for, what became of it seen from both ends, and how one keeps up with its two hosts."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

import msgspec

from zmav.errors import Refused, TimedOut
from zmav.waiting import within
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
            start=0.0, end=self.sender.send_seconds, bytes=0, received=0, expected=0, jitter=0.0
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


POLL = 0.5
"""s between questions to a host that measures"""
TRIES = 4
GRACE = 2.0
"""s after the sender's end for datagrams that are still on their way"""
GIVE_UP = 10.0
"""s beyond a run's time after which a host that says nothing is given up"""

OnInterval = Callable[[Flow, BenchInterval], None]
OnOutage = Callable[[Flow, BenchOutage], None]
Ask = Callable[..., Awaitable[BenchReport]]
"""of :meth:`mesh.bench.asker.Bench.report`"""
Stop = Callable[[str, str], Awaitable[None]]


class Follow:
    """Keeps up with the hosts of a stream until it is over; what goes wrong is in the flow's ``faults``."""

    def __init__(
        self, ask: Ask, stop: Stop, flow: Flow, on_interval: OnInterval | None, on_outage: OnOutage | None
    ) -> None:
        self._report, self._stop, self._flow = ask, stop, flow
        self._on_interval, self._on_outage = on_interval, on_outage
        self._silent = dict.fromkeys((flow.source, flow.target), 0)
        """questions in a row that a host has not answered"""

    async def to_the_end(self, until: asyncio.Event | None) -> None:
        flow, loop, stopped = self._flow, asyncio.get_running_loop(), False
        seconds = flow.stream.seconds
        deadline = loop.time() + seconds + 2.0 * GIVE_UP
        while loop.time() < deadline:
            await self._look()
            if until is not None and until.is_set() and not stopped:
                stopped = True
                await self._stop(flow.source, flow.sender.run)  # what is on its way is still counted
                deadline = min(deadline, loop.time() + GRACE)
            if "failed" in (flow.sender.state, flow.receiver.state):
                break
            if flow.sender.state not in ("waiting", "running") or flow.sender.send_seconds >= seconds:
                if self._is_whole(stopped):
                    break
                deadline = min(deadline, loop.time() + GRACE)
            await pause(POLL if not stopped else 0.1, None if stopped else until)
        await self._look(tries=TRIES)
        self._judge()

    def _is_whole(self, stopped: bool) -> bool:
        flow = self._flow
        told = stopped or len(flow.intervals) >= int(flow.stream.seconds)
        return told and flow.receiver.total is not None and flow.receiver.total.received >= flow.sender.sent

    async def _look(self, tries: int = 1) -> None:
        """Ask both hosts, side by side; one that does not answer is asked again the next time."""
        flow = self._flow
        sender, receiver = await asyncio.gather(self._ask(flow.source, tries), self._ask(flow.target, tries))
        flow.sender = sender or flow.sender
        if receiver is not None:
            flow.receiver = receiver
            self._take(receiver)

    async def _ask(self, host: str, tries: int) -> BenchReport | None:
        flow = self._flow
        since, outages = (len(flow.intervals), len(flow.outages)) if host == flow.target else (0, 0)
        try:
            report = await self._report(
                host, flow.sender.run, since=since, outages=outages, tries=1 if self._silent[host] > 1 else tries
            )
        except (TimedOut, Refused) as e:
            if isinstance(e, Refused):
                self._say(str(e))
            self._silent[host] += 1
            return None
        self._silent[host] = 0
        return report

    def _take(self, report: BenchReport) -> None:
        flow = self._flow
        for interval in report.intervals:
            if interval.start != len(flow.intervals) or interval.start >= flow.stream.seconds:
                continue  # told twice, or what trickled in after the end
            flow.intervals.append(interval)
            if self._on_interval:
                self._on_interval(flow, interval)
        for outage in report.outages:
            flow.outages.append(outage)
            if self._on_outage:
                self._on_outage(flow, outage)

    def _judge(self) -> None:
        flow = self._flow
        for host, report in ((flow.source, flow.sender), (flow.target, flow.receiver)):
            if report.state == "failed":
                self._say(f"{host}: {report.why}")
            elif self._silent[host]:
                self._say(f"{host} does not answer any more: what it saw last is shown")
            elif report.state == "stopped" and report.why != "asked to":
                self._say(f"{host} stopped: {report.why}")
        if flow.sender.skipped:
            self._say(f"{flow.source} could not keep up: {flow.sender.skipped} datagrams were not sent")

    def _say(self, text: str) -> None:
        if text not in self._flow.faults:
            self._flow.faults.append(text)


async def pause(seconds: float, until: asyncio.Event | None) -> None:
    """Sleep, or less where ``until`` is set meanwhile."""
    if until is None:
        await asyncio.sleep(seconds)
        return
    with contextlib.suppress(asyncio.TimeoutError):
        await within(seconds, until.wait())
