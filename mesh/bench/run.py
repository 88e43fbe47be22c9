"""One host's part in one run: it sends, receives, echoes or asks, for a time that was limited when it began."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Iterator
from typing import Any

import zenoh

from mesh.bench import datagram
from mesh.bench.pinger import TIMEOUT, Pinger
from mesh.bench.sender import Sender
from mesh.bench.statistics import SECOND, RoundTrips, Tally
from mesh.bench.streams import heard, open_receiver, open_sender
from zmav import keys
from zmav.errors import BadInput
from zmav.session import reason
from zmav.waiting import within
from zmav.wire.bench import BenchOrder, BenchQuery, BenchReport, BenchState, BenchTrip

LONGEST = 3600.0
"""s of a run"""
MOST_HZ = 50_000.0
MOST_BITS = 1e9
MOST_DATAGRAMS = 50_000_000
MOST_PEERS = 16
MOST_QUERIES = 500.0
"""a second: they are made on the event loop, where everything else of the host is, too"""
FOUND_WITHIN = 10.0
"""s for the other's subscription to become known here"""
TAIL = 3.0
"""s that datagrams may need after the last one was sent"""
FIRST_LOOKS, FIRST_HZ = 5, 20.0
"""exchanges of clocks before a stream begins, and how fast"""
BEAT = 0.1
_LIMITS = {
    "seconds": (0.1, LONGEST),
    "hz": (0.01, MOST_HZ),
    "size": (datagram.LEAST, datagram.MOST),
    "gap": (0.001, 60.0),
    "guard": (0.0, 50.0),
    "patience": (1.0, 300.0),
}
_SENDS, _RECEIVES = ("send", "both", "ping"), ("receive", "both", "ping", "echo")


def check(order: BenchOrder, host: str) -> None:
    """Raise :class:`BadInput` naming the field of an order that no host should follow."""
    for name, (low, high) in _LIMITS.items():
        value = getattr(order, name)
        if not low <= value <= high:  # NaN, too
            raise _wrong(name, value, f"{low:g} to {high:g}")
    if order.hz * order.seconds > MOST_DATAGRAMS:
        raise _wrong("hz", order.hz, f"at most {MOST_DATAGRAMS:,} datagrams in a run")
    if order.hz * order.size * 8.0 > MOST_BITS:
        raise _wrong("hz", order.hz, f"at most {MOST_BITS / 1e6:.0f} Mbit/s")
    if order.role == "query" and order.hz * len(order.peers) > MOST_QUERIES:
        raise _wrong("hz", order.hz, f"at most {MOST_QUERIES:.0f} queries a second")
    keys.check_name(order.run, "run")
    if len(order.run) > 40:
        raise _wrong("run", order.run, "40 characters at most")
    if len(order.asker) > 100 or not order.asker.isprintable():
        raise _wrong("asker", repr(order.asker[:100]), "100 printable characters at most")
    if not 1 <= len(order.peers) <= MOST_PEERS or (len(order.peers) > 1 and order.role != "query"):
        raise _wrong("peers", order.peers, "one host, or up to 16 to ask")
    for peer in order.peers:
        keys.check_name(peer, "peers")
        if peer == host:
            raise _wrong("peers", peer, f"another host than {host} itself")


def _wrong(field: str, value: object, expected: str) -> BadInput:
    return BadInput(f"{field} is {value}; expected {expected}", field=field, value=value, expected=expected)


class Run:
    """Made when it is ordered; :meth:`go` lasts as long as it does. On the event loop."""

    def __init__(self, session: zenoh.Session, fleet: str, host: str, order: BenchOrder) -> None:
        self._session, self._fleet, self._host, self.order = session, fleet, host, order
        self.began = time.monotonic()
        self._heard_of = self.began
        self._state: BenchState = "waiting"
        self._why = ""
        self._ended: float | None = None
        self._stop = asyncio.Event()
        total, period = self._total, int(SECOND / order.hz)
        self._tally = Tally(total, period, int(order.gap * SECOND)) if order.role in ("receive", "both") else None
        self._trips = RoundTrips(int(TIMEOUT * SECOND))
        self._sender: Sender | None = None
        self._pingers: list[Pinger] = []
        self._tag = datagram.tag_of(order.run)
        self._qos = keys.Qos(order.qos)

    @property
    def _total(self) -> int:
        return max(1, math.ceil(self.order.hz * self.order.seconds - 1e-9))

    @property
    def over(self) -> bool:
        return self._ended is not None

    @property
    def age(self) -> float:
        """s since its end; 0 before."""
        return time.monotonic() - self._ended if self._ended is not None else 0.0

    def word(self) -> None:
        """The asker is still there."""
        self._heard_of = time.monotonic()

    def stop(self) -> None:
        self._stop.set()

    def describe(self) -> str:
        """What goes on here, for somebody who would like to measure, too."""
        order, since = self.order, time.monotonic() - self.began
        who = f" for {order.asker}" if order.asker else ""
        return f"{order.role} with {', '.join(order.peers)}{who} since {since:.0f} s, for {order.seconds:.0f} s"

    async def go(self) -> None:
        """Until done, stopped, or forgotten by who asked for it."""
        watch = asyncio.ensure_future(self._watch())
        work = asyncio.ensure_future(self._work())
        try:
            await asyncio.wait({watch, work}, return_when=asyncio.FIRST_COMPLETED)
            if work.done() and (error := work.exception()) is not None:
                self._finish("failed", reason(error) if isinstance(error, zenoh.ZError) else repr(error))
            elif work.done():
                self._finish("done")
            else:
                self._finish("stopped", watch.result())
        finally:
            self._finish("stopped", "the host's router ended")
            for task in (watch, work):
                task.cancel()
            await asyncio.gather(watch, work, return_exceptions=True)

    def _finish(self, state: BenchState, why: str = "") -> None:
        if self._ended is None:
            self._ended = time.monotonic()
            self._why = self._why or why
            self._state = state if self._state in ("waiting", "running") else self._state

    async def _watch(self) -> str:
        """Why it has to end before its time."""
        while not self._stop.is_set():
            with contextlib.suppress(asyncio.TimeoutError):
                await within(BEAT, self._stop.wait())
            if time.monotonic() - self._heard_of > self.order.patience:
                return f"no word from who asked for it for {self.order.patience:g} s"
        return "asked to"

    async def _work(self) -> None:
        role = self.order.role
        if role == "query":
            await self._query()
        elif role == "echo":
            await self._echo()
        else:
            await self._stream()

    # Asking.

    async def _query(self) -> None:
        order = self.order
        self._pingers = [Pinger(self._session, self._fleet, peer, self._qos) for peer in order.peers]
        self._state = "running"
        await asyncio.gather(*(pinger.ask_for(order.seconds, order.hz) for pinger in self._pingers))
        await asyncio.gather(*(pinger.settled() for pinger in self._pingers))

    # Datagrams.

    def _flow(self, host: str) -> str:
        return keys.BENCH_FLOW.key(self._fleet, host, run=self.order.run)

    @contextlib.contextmanager
    def _receiver(self, take: Any) -> Iterator[None]:
        subscriber = open_receiver(self._session, self._flow(self.order.peers[0]), self._qos, take)
        try:
            yield
        finally:
            with contextlib.suppress(zenoh.ZError):  # the session may be gone before us
                subscriber.undeclare()

    @contextlib.contextmanager
    def _publisher(self) -> Iterator[Any]:
        publisher = open_sender(self._session, self._flow(self._host), self._qos, self.order.reliable)
        try:
            yield publisher
        finally:
            with contextlib.suppress(zenoh.ZError):
                publisher.undeclare()

    async def _echo(self) -> None:
        with self._publisher() as publisher:
            if not await self._is_heard():
                return

            def take(sample: zenoh.Sample) -> None:
                with contextlib.suppress(zenoh.ZError):  # it has just ended
                    publisher.put(sample.payload)

            with self._receiver(take):
                self._state = "running"
                await asyncio.sleep(self.order.seconds + TAIL + FOUND_WITHIN)

    async def _stream(self) -> None:
        order = self.order
        with contextlib.ExitStack() as stack:
            if order.role in _RECEIVES:
                stack.enter_context(self._receiver(self._take_trip if order.role == "ping" else self._take))
            if order.role not in _SENDS:
                self._state = "running"
                await asyncio.sleep(order.seconds + TAIL + 2.0 * FOUND_WITHIN)
                return
            publisher = stack.enter_context(self._publisher())
            if not await self._is_heard():
                return
            if order.guard:
                idle = Pinger(self._session, self._fleet, order.peers[0], keys.Qos.REALTIME)
                self._pingers = [idle]
                await idle.ask_for(FIRST_LOOKS / FIRST_HZ, FIRST_HZ)
                self._pingers.append(Pinger(self._session, self._fleet, order.peers[0], keys.Qos.REALTIME, idle.clock))
            await self._send(publisher, stack)
            await self._tail()

    async def _send(self, publisher: Any, stack: contextlib.ExitStack) -> None:
        order = self.order
        sender = Sender(publisher.put, self._tag, hz=order.hz, size=order.size, total=self._total)
        stack.callback(sender.stop)
        self._sender, self._state = sender, "running"
        sender.start()
        guards = [asyncio.ensure_future(pinger.ask_for(order.seconds, order.guard)) for pinger in self._pingers[1:]]
        try:
            while sender.running:
                await asyncio.sleep(BEAT)
        finally:
            for guard in guards:
                guard.cancel()
        if sender.error:
            self._state, self._why = "failed", sender.error

    async def _tail(self) -> None:
        """Wait for what is on its way, and be there for what has to be sent again."""
        end = time.monotonic() + TAIL
        while time.monotonic() < end:
            if self.order.role == "ping" and self._sender and self._trips.answered >= self._sender.sent:
                return
            await asyncio.sleep(BEAT)

    async def _is_heard(self) -> bool:
        if await heard(self._session, self._flow(self._host), FOUND_WITHIN):
            return True
        peer = self.order.peers[0]
        self._state = "failed"
        self._why = f"nothing of {peer} is known at {self._host}: no way between them, or {peer} does not take part"
        return False

    def _take(self, sample: zenoh.Sample) -> None:
        now = time.monotonic_ns()
        data = sample.payload.to_bytes()
        found = datagram.read(data, self._tag)
        assert self._tally is not None
        if found is None:
            self._tally.foreign += 1
        else:
            self._tally.take(*found, len(data), now)

    def _take_trip(self, sample: zenoh.Sample) -> None:
        now = time.monotonic_ns()
        found = datagram.read(sample.payload.to_bytes(), self._tag)
        if found is not None and found[0] < self._total:
            self._trips.take(*found, now)

    # What there is to tell.

    def report(self, query: BenchQuery) -> BenchReport:
        order, tally, sender, now = self.order, self._tally, self._sender, time.monotonic_ns()
        spread = sender.lateness().spread() if sender else None
        report = BenchReport(
            run=order.run,
            host=self._host,
            role=order.role,
            state=self._state,
            why=self._why,
            elapsed=(self._ended or time.monotonic()) - self.began,
            sent=sender.sent if sender else 0,
            send_seconds=sender.seconds if sender else 0.0,
            skipped=sender.skipped if sender else 0,
            lateness=spread,
            clock=next((pinger.clock.read() for pinger in self._pingers), None),
            trips=self._trips_so_far(sender),
        )
        if tally is not None:
            report.total, report.silent = tally.total(), tally.silent(now)
            report.intervals = tally.intervals(now, max(query.since, 0))
            report.outages, report.outage_count = tally.outages(max(query.outages, 0)), tally.outage_count
            report.foreign = tally.foreign
        return report

    def _trips_so_far(self, sender: Sender | None) -> list[BenchTrip]:
        if self.order.role != "ping":
            return [pinger.trip() for pinger in self._pingers]
        sent = sender.sent if sender else 0
        trips, answered = self._trips, self._trips.answered
        return [
            BenchTrip(
                peer=self.order.peers[0], sent=sent, lost=max(sent - answered, 0), late=trips.late, rtt=trips.spread()
            )
        ]
