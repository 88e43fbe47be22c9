"""Keeping up with the two hosts of a stream until it is over, whatever becomes of them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol

from mesh.bench.flow import Flow, Stream
from zmav.errors import Refused, TimedOut
from zmav.wire.bench import BenchClock, BenchInterval, BenchOutage, BenchReport

POLL = 0.5
"""s between questions to a host that measures"""
TRIES = 4
GRACE = 2.0
"""s after the sender's end for datagrams that are still on their way"""
GIVE_UP = 10.0
"""s beyond a run's time after which a host that says nothing is given up"""

OnInterval = Callable[[Flow, BenchInterval], None]
OnOutage = Callable[[Flow, BenchOutage], None]
Stop = Callable[[str, str], Awaitable[None]]


class Ask(Protocol):
    """:meth:`mesh.bench.asker.Bench.report`"""

    async def __call__(
        self, host: str, run: str, *, since: int = 0, outages: int = 0, tries: int = 1
    ) -> BenchReport: ...


class Follow:
    """Keeps up with the hosts of a stream until it is over."""

    def __init__(
        self,
        ask: Ask,
        stop: Stop,
        stream: Stream,
        flows: list[Flow],
        on_interval: OnInterval | None,
        on_outage: OnOutage | None,
    ) -> None:
        self._report, self._stop, self._stream, self._flows = ask, stop, stream, flows
        self._on_interval, self._on_outage = on_interval, on_outage
        self._silent: dict[str, int] = {}
        self._faults: list[str] = []

    async def to_the_end(self, until: asyncio.Event | None) -> list[str]:
        """What went wrong, in words."""
        loop, stopped = asyncio.get_running_loop(), False
        deadline = loop.time() + self._stream.seconds + 2.0 * GIVE_UP
        run = self._flows[0].sender.run
        while loop.time() < deadline:
            await self._look()
            if until is not None and until.is_set() and not stopped:
                stopped = True
                for host in sorted({flow.source for flow in self._flows}):
                    await self._stop(host, run)  # what is on its way is still counted
                deadline = min(deadline, loop.time() + GRACE)
            if self._failed():
                break
            if all(flow.sender.state not in ("waiting", "running") or self._sent_all(flow) for flow in self._flows):
                if all(self._whole(flow, stopped) for flow in self._flows):
                    break
                deadline = min(deadline, loop.time() + GRACE)
            await pause(POLL if not stopped else 0.1, None if stopped else until)
        await self._look(tries=TRIES)
        for flow in self._flows:
            self._judge(flow)
        return self._faults

    def _hosts(self) -> list[str]:
        return sorted({name for flow in self._flows for name in (flow.source, flow.target)})

    def _sent_all(self, flow: Flow) -> bool:
        return flow.sender.send_seconds >= self._stream.seconds

    def _whole(self, flow: Flow, stopped: bool) -> bool:
        told = stopped or len(flow.intervals) >= int(self._stream.seconds)
        return told and flow.receiver.total is not None and flow.receiver.total.received >= flow.sender.sent

    def _failed(self) -> bool:
        return any(report.state == "failed" for flow in self._flows for report in (flow.sender, flow.receiver))

    async def _look(self, tries: int = 1) -> None:
        """Ask every host, side by side; one that does not answer is asked again the next time."""
        found = await asyncio.gather(
            *(self._ask(host, 1 if self._silent.get(host, 0) > 1 else tries) for host in self._hosts())
        )
        reports = dict(zip(self._hosts(), found, strict=True))
        for flow in self._flows:
            flow.sender = reports[flow.source] or flow.sender
            if (report := reports[flow.target]) is not None:
                flow.receiver = report
                self._take(flow, report)
        clock = self._flows[0].sender.clock
        for flow, sign in zip(self._flows, (1.0, -1.0), strict=False):
            flow.clock = clock and BenchClock(
                offset=sign * clock.offset, within=clock.within, utc_offset=sign * clock.utc_offset
            )

    async def _ask(self, host: str, tries: int) -> BenchReport | None:
        flow = next((flow for flow in self._flows if flow.target == host), None)
        since, outages = (len(flow.intervals), len(flow.outages)) if flow else (0, 0)
        try:
            report = await self._report(host, self._flows[0].sender.run, since=since, outages=outages, tries=tries)
        except TimedOut:
            self._silent[host] = self._silent.get(host, 0) + 1
            return None
        except Refused as e:
            if str(e) not in self._faults:
                self._faults.append(str(e))
            self._silent[host] = self._silent.get(host, 0) + 1
            return None
        self._silent[host] = 0
        return report

    def _take(self, flow: Flow, report: BenchReport) -> None:
        for interval in report.intervals:
            if interval.start != len(flow.intervals) or interval.start >= self._stream.seconds:
                continue  # told twice, or what trickled in after the end
            flow.intervals.append(interval)
            if self._on_interval:
                self._on_interval(flow, interval)
        for outage in report.outages:
            flow.outages.append(outage)
            if self._on_outage:
                self._on_outage(flow, outage)

    def _judge(self, flow: Flow) -> None:
        for host, report in ((flow.source, flow.sender), (flow.target, flow.receiver)):
            if report.state == "failed":
                self._say(f"{host}: {report.why}")
            elif self._silent.get(host):
                self._say(f"{host} does not answer any more: what it saw last is shown")
            elif report.state == "stopped" and report.why != "asked to":
                self._say(f"{host} stopped: {report.why}")
        if flow.sender.skipped:
            self._say(f"{flow.source} could not keep up: {flow.sender.skipped} datagrams were not sent")

    def _say(self, text: str) -> None:
        if text not in self._faults:
            self._faults.append(text)


async def pause(seconds: float, until: asyncio.Event | None) -> None:
    """Sleep, or less where ``until`` is set meanwhile."""
    if until is None:
        await asyncio.sleep(seconds)
        return
    task = asyncio.ensure_future(until.wait())
    await asyncio.wait({task}, timeout=seconds)
    task.cancel()
