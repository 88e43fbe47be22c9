"""Who asks: finds the two hosts, tells each its part, follows both, and puts together what they saw.

async with zmav.open() as z:
    result = await Bench(z).stream("quad1", "quad2", Stream(seconds=20.0, hz=125.0, size=1000))
    print(result.flows[0].total.jitter)
"""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import secrets
import socket
from collections.abc import AsyncIterator, Callable
from typing import NamedTuple

import msgspec

from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import BadInput, Clash, NoSuchVehicle, Refused, SessionError, TimedOut, ZmavError
from zmav.wire.bench import (
    BenchClock,
    BenchInterval,
    BenchOrder,
    BenchOutage,
    BenchQos,
    BenchQuery,
    BenchReport,
    BenchRole,
    BenchStop,
    BenchTrip,
    Pong,
    Spread,
)

HERE = "here"
TRIES, ANSWER = 4, 1.0
"""times an order or a question is sent, and s for each answer"""
POLL = 0.5
"""s between questions to a host that measures"""
GRACE = 2.0
"""s after the sender's end for datagrams that are still on their way"""
GIVE_UP = 10.0
"""s beyond a run's time after which a host that says nothing is given up"""


class Stream(msgspec.Struct, kw_only=True, frozen=True):
    """What is sent."""

    seconds: float = 20.0
    hz: float = 125.0
    size: int = 1000
    qos: BenchQos = "latest-wins"
    reliable: bool | None = None
    """None: as the class is: bulk is sent once and everything else is repeated by the link where it is lost"""
    gap: float | None = None
    """s of silence that are an outage; None: five datagrams' time, and 0.2 s at least"""
    guard: float = 2.0
    """Hz of realtime queries beside it, which also compare the clocks"""
    patience: float = 8.0

    @property
    def silence(self) -> float:
        return self.gap if self.gap is not None else min(max(5.0 / self.hz, 0.2), 60.0)

    @property
    def bits(self) -> float:
        """Of payload a second."""
        return self.hz * self.size * 8.0


class Flow(msgspec.Struct, kw_only=True):
    """One direction of a stream, as far as it is known."""

    source: str
    target: str
    sender: BenchReport
    receiver: BenchReport
    clock: BenchClock | None = None
    """the target's clock less the source's"""
    intervals: list[BenchInterval] = []
    outages: list[BenchOutage] = []

    @property
    def total(self) -> BenchInterval:
        """The whole run; what was sent and never came is lost, the last datagrams too."""
        found = self.receiver.total or BenchInterval(
            start=0.0, end=self.sender.send_seconds, bytes=0, received=0, expected=0, jitter=0.0, out_of_order=0,
            duplicates=0,
        )  # fmt: skip
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


class StreamResult(msgspec.Struct, kw_only=True):
    """What a stream came to."""

    stream: Stream
    flows: list[Flow]
    """there, and back where both ways were asked for"""
    faults: list[str] = []
    """what went wrong, in words"""

    @property
    def idle(self) -> BenchTrip | None:
        """Round trips of the realtime class just before."""
        return self._trip(0)

    @property
    def loaded(self) -> BenchTrip | None:
        """Round trips of the realtime class beside the stream."""
        return self._trip(1)

    def _trip(self, place: int) -> BenchTrip | None:
        trips = self.flows[0].sender.trips
        return trips[place] if place < len(trips) else None


class _Part(NamedTuple):
    host: str
    order: BenchOrder


OnInterval = Callable[[Flow, BenchInterval], None]
OnOutage = Callable[[Flow, BenchOutage], None]


class Bench:
    """Measurements between hosts of one fleet, through a client of any of its routers."""

    def __init__(self, client: Client) -> None:
        if client.fleet_name == "*":
            raise BadInput("measure in one fleet: name it", field="fleet", value="*", expected="a fleet's name")
        self._client, self._fleet = client, client.fleet_name
        self._asker = f"{getpass.getuser()}@{socket.gethostname()}"

    # Who is there.

    async def everyone(self) -> list[Pong]:
        """Every host that answers within a second, by name."""
        answers = await self._client.ask(keys.BENCH_PING.key(self._fleet, "*"), timeout=ANSWER, channel=keys.BENCH_PING)
        found = [_pong(answer) for answer in answers if isinstance(answer, Answer)]
        return sorted((pong for pong in found if pong), key=lambda pong: pong.host)

    async def find(self, name: str) -> Pong:
        """The host of that name, or ours for ``here``; raises :class:`NoSuchVehicle` naming those there are."""
        zids = [str(zid) for zid in self._client.session.info.routers_zid()]
        if name != HERE:
            keys.check_name(name, "host")
        for _ in range(TRIES):
            present = await self.everyone()
            found = [pong for pong in present if (pong.zid in zids if name == HERE else pong.host == name)]
            if len({pong.zid for pong in found}) > 1:
                raise Clash(f"{len(found)} hosts are named {name}: which is meant?", host=name)
            if found:
                return found[0]
        if name == HERE:
            text = "our own host's router takes part in no measurement: run 'zmav router' or 'zmav up' of this version"
            raise SessionError(text, routers=zids)
        known = ", ".join(pong.host for pong in present) or "nobody"
        raise NoSuchVehicle(f"no host {name!r} answers (there are: {known})", missing=[name])

    async def pair(self, a: str, b: str) -> tuple[Pong, Pong]:
        """Two hosts that are not one; raises :class:`BadInput` where they are."""
        first, second = await asyncio.gather(self.find(a), self.find(b))
        if first.zid == second.zid:
            raise BadInput(f"{a} and {b} are one host ({first.host})", field="host", value=b, expected="another host")
        return first, second

    # Measurements.

    async def stream(
        self, a: str, b: str, stream: Stream, *, both: bool = False, until: asyncio.Event | None = None,
        on_interval: OnInterval | None = None, on_outage: OnOutage | None = None,
    ) -> StreamResult:  # fmt: skip
        """Have ``a`` send to ``b`` (and back). Ends early when ``until`` is set. Raises what a host refuses."""
        first, second = (pong.host for pong in await self.pair(a, b))
        reliable = stream.reliable if stream.reliable is not None else stream.qos != keys.Qos.BULK.value
        run = _new_run()

        def part(host: str, peer: str, role: BenchRole, guard: float) -> _Part:
            order = BenchOrder(
                run=run, role=role, peers=[peer], seconds=stream.seconds, hz=stream.hz, size=stream.size,
                qos=stream.qos, reliable=reliable, gap=stream.silence, guard=guard, patience=stream.patience,
                asker=self._asker,
            )  # fmt: skip
            return _Part(host, order)

        parts = [
            part(second, first, "both" if both else "receive", 0.0),
            part(first, second, "both" if both else "send", stream.guard),
        ]
        async with self._running(parts) as reports:
            back, there = reports
            flows = [Flow(source=first, target=second, sender=there, receiver=back)]
            if both:
                flows.append(Flow(source=second, target=first, sender=back, receiver=there))
            follow = _Follow(self, stream, flows, on_interval, on_outage)
            faults = await follow.to_the_end(until)
        return StreamResult(stream=stream, flows=flows, faults=faults)

    async def round_trips(self, a: str, b: str, stream: Stream, *, until: asyncio.Event | None = None) -> BenchReport:
        """Round trips from ``a`` to ``b`` and back in a class: datagrams, or queries in the must-arrive class."""
        first, second = (pong.host for pong in await self.pair(a, b))
        if stream.qos == keys.Qos.MUST_ARRIVE.value:
            return await self.queries(first, [second], stream, until=until)
        order = self._order("echo", [first], stream)
        parts = [_Part(second, order), _Part(first, msgspec.structs.replace(order, role="ping", peers=[second]))]
        async with self._running(parts):
            return await self._until_over(first, order.run, stream.seconds, until)

    async def queries(
        self, a: str, peers: list[str], stream: Stream, *, until: asyncio.Event | None = None
    ) -> BenchReport:
        """Round trips by query from ``a`` to each of ``peers``, side by side."""
        order = self._order("query", peers, stream)
        async with self._running([_Part(a, order)]):
            return await self._until_over(a, order.run, stream.seconds, until)

    def _order(self, role: BenchRole, peers: list[str], stream: Stream) -> BenchOrder:
        reliable = stream.reliable if stream.reliable is not None else stream.qos != keys.Qos.BULK.value
        return BenchOrder(
            run=_new_run(), role=role, peers=peers, seconds=stream.seconds, hz=stream.hz, size=stream.size,
            qos=stream.qos, reliable=reliable, patience=stream.patience, asker=self._asker,
        )  # fmt: skip

    async def _until_over(self, host: str, run: str, seconds: float, until: asyncio.Event | None) -> BenchReport:
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds + GIVE_UP
        while True:
            with contextlib.suppress(TimedOut):
                report = await self.report(host, run)
                if report.state not in ("waiting", "running") or (until is not None and until.is_set()):
                    if report.state == "failed":
                        raise Refused(f"{host}: {report.why}", host=host)
                    return report
            if loop.time() > end:
                raise TimedOut(f"{host} says no more", host=host)
            await _pause(POLL, until)

    # Orders.

    @contextlib.asynccontextmanager
    async def _running(self, parts: list[_Part]) -> AsyncIterator[list[BenchReport]]:
        """Each host's part begun, and ended whatever happens; the first answers."""
        begun: list[str] = []
        try:
            reports = []
            for host, order in parts:
                begun.append(host)
                reports.append(await self._tell(host, "start", order))
            yield reports
        finally:
            run = parts[0].order.run
            await asyncio.shield(asyncio.gather(*(self._stop(host, run) for host in begun)))

    async def _stop(self, host: str, run: str) -> None:
        with contextlib.suppress(ZmavError):  # it ends by itself, then: nobody asks for its report any more
            await self._tell(host, "stop", BenchStop(run=run), tries=2)

    async def _tell(self, host: str, order: str, payload: msgspec.Struct, tries: int = TRIES) -> BenchReport:
        key = keys.BENCH.key(self._fleet, host, order=order)
        return await self._answer(host, key, wire.encode(payload), keys.BENCH, tries)

    async def report(self, host: str, run: str, *, since: int = 0, outages: int = 0, tries: int = 1) -> BenchReport:
        """What a host has to tell of a run; raises :class:`TimedOut` where it does not answer."""
        key = keys.BENCH_REPORT.key(self._fleet, host, run=run)
        query = BenchQuery(since=since, outages=outages)
        return await self._answer(host, key, wire.encode(query), keys.BENCH_REPORT, tries)

    async def _answer(self, host: str, key: str, payload: bytes, channel: keys.Channel, tries: int) -> BenchReport:
        for _ in range(tries):
            answers = await self._client.ask(key, payload, ANSWER, channel, enough=lambda _: True)
            for answer in answers:
                if isinstance(answer, ZmavError):
                    raise answer
                return wire.decode(answer.payload, BenchReport, f"report of {host}")
        raise TimedOut(f"{host} does not answer", host=host)


class _Follow:
    """Keeps up with the hosts of a stream until it is over."""

    def __init__(
        self, bench: Bench, stream: Stream, flows: list[Flow], on_interval: OnInterval | None,
        on_outage: OnOutage | None,
    ) -> None:  # fmt: skip
        self._bench, self._stream, self._flows = bench, stream, flows
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
                for host in self._hosts():
                    await self._bench._stop(host, run)
                deadline = min(deadline, loop.time() + GRACE)
            if self._failed():
                break
            if all(flow.sender.state not in ("waiting", "running") or self._sent_all(flow) for flow in self._flows):
                if all(self._whole(flow) for flow in self._flows):
                    break
                deadline = min(deadline, loop.time() + GRACE)
            await _pause(POLL if not stopped else 0.1, None if stopped else until)
        await self._look(tries=TRIES)
        for flow in self._flows:
            self._judge(flow)
        return self._faults

    def _hosts(self) -> list[str]:
        return sorted({name for flow in self._flows for name in (flow.source, flow.target)})

    def _sent_all(self, flow: Flow) -> bool:
        return flow.sender.send_seconds >= self._stream.seconds

    def _whole(self, flow: Flow) -> bool:
        told = len(flow.intervals) >= int(self._stream.seconds)
        return told and flow.receiver.total is not None and flow.receiver.total.received >= flow.sender.sent

    def _failed(self) -> bool:
        return any(report.state == "failed" for flow in self._flows for report in (flow.sender, flow.receiver))

    async def _look(self, tries: int = 1) -> None:
        """Ask every host, side by side; one that does not answer is asked again the next time."""
        found = await asyncio.gather(*(self._ask(host, tries) for host in self._hosts()))
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
            report = await self._bench.report(
                host, self._flows[0].sender.run, since=since, outages=outages, tries=tries
            )
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


def _new_run() -> str:
    return secrets.token_hex(4)


def _pong(answer: Answer) -> Pong | None:
    try:
        return wire.decode(answer.payload, Pong, "pong")
    except BadInput:
        return None


async def _pause(seconds: float, until: asyncio.Event | None) -> None:
    """Sleep, or less where ``until`` is set meanwhile."""
    if until is None:
        await asyncio.sleep(seconds)
        return
    task = asyncio.ensure_future(until.wait())
    await asyncio.wait({task}, timeout=seconds)
    task.cancel()
