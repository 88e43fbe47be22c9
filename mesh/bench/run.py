"""One host's part in one run: it sends, receives or asks, for a time that was limited when it began."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

from mesh.bench.pinger import Pinger
from mesh.bench.statistics import SECOND, Samples, Tally
from zmav import keys
from zmav.errors import BadInput
from zmav.session import reason
from zmav.waiting import alongside, on_loop, within
from zmav.wire.bench import BenchOrder, BenchQuery, BenchReport, BenchState

HEAD = struct.Struct("<IIq")
"""of a datagram: the run's tag, the number from 0, the sender's monotonic clock in ns; random bytes follow, so that no
compression flatters the link. All of it is payload: what Zenoh, IP and the radio add comes on top."""
LEAST, MOST = HEAD.size, 65_000
"""bytes of a datagram"""
BEHIND = SECOND // 10
"""ns behind its times after which the sender gives up datagrams instead of sending a burst"""


def tag_of(run: str) -> int:
    return zlib.crc32(run.encode())


def read_datagram(data: bytes, tag: int) -> tuple[int, int] | None:
    """A datagram's number and when it was sent; None where it is none of this run's."""
    if len(data) < LEAST:
        return None
    its_tag, number, sent = HEAD.unpack_from(data)
    return (number, sent) if its_tag == tag else None


class Sender:
    """Calls ``put`` with ``total`` datagrams, one every ``1/hz`` s, from a thread: the event loop's own timing would be
    what is measured. It ends by itself, or by :meth:`stop`.
    """

    def __init__(self, put: Callable[[bytes], None], tag: int, *, hz: float, size: int, total: int) -> None:
        self._put, self._tag, self._period, self._total = put, tag, SECOND / hz, total
        self._filling = os.urandom(size - LEAST)
        self.lateness = Samples()
        self._stop = False
        self._began = self._ended = 0
        self.sent = 0
        self.skipped = 0
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="bench-sender", daemon=True)

    def start(self) -> None:
        self._began = time.monotonic_ns()
        self._thread.start()

    def stop(self) -> None:
        self._stop = True

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    @property
    def seconds(self) -> float:
        """From the first datagram's time to the end of the last one's, or to now."""
        if not self._began:
            return 0.0
        return ((self._ended or time.monotonic_ns()) - self._began) / SECOND

    def _run(self) -> None:
        try:
            self._send_all()
        except zenoh.ZError as e:
            self.error = reason(e)  # the session has closed
        finally:
            planned = 0 if self._stop or self.error else int((self.sent + self.skipped) * self._period)
            self._ended = max(time.monotonic_ns(), self._began + planned)

    def _send_all(self) -> None:
        now, put, late = time.monotonic_ns, self._put, self.lateness.add
        tag, filling, period, start = self._tag, self._filling, self._period, float(self._began)
        slot = 0  # the datagram's place in time; its number counts those that were sent
        while slot < self._total and not self._stop:
            due = start + slot * period
            t = now()
            if t < due:
                time.sleep((due - t) / SECOND)
                continue
            if t - due > BEHIND:
                missed = min(int((t - due) / period), self._total - slot)
                self.skipped += missed
                slot += missed
                continue
            late(int(t - due))
            put(HEAD.pack(tag, self.sent, t) + filling)
            self.sent += 1
            slot += 1


LONGEST = 3600.0
"""s of a run"""
MOST_HZ = 50_000.0
MOST_BITS = 1e9
MOST_DATAGRAMS = 50_000_000
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
    "size": (LEAST, MOST),
    "gap": (0.001, 60.0),
    "guard": (0.0, 50.0),
    "patience": (1.0, 300.0),
}


def check(order: BenchOrder, host: str) -> None:
    """Raise :class:`BadInput` naming the field of an order that no host should follow."""
    for name, (low, high) in _LIMITS.items():
        value = getattr(order, name)
        if not low <= value <= high:  # NaN, too
            raise BadInput.wrong(name, value, f"{low:g} to {high:g}")
    if order.hz * order.seconds > MOST_DATAGRAMS:
        raise BadInput.wrong("hz", order.hz, f"at most {MOST_DATAGRAMS:,} datagrams in a run")
    if order.hz * order.size * 8.0 > MOST_BITS:
        raise BadInput.wrong("hz", order.hz, f"at most {MOST_BITS / 1e6:.0f} Mbit/s")
    if order.role == "query" and order.hz > MOST_QUERIES:
        raise BadInput.wrong("hz", order.hz, f"at most {MOST_QUERIES:.0f} queries a second")
    if order.role != "query" and order.qos == keys.Qos.MUST_ARRIVE.value:
        raise BadInput.wrong("qos", order.qos, "a class that datagrams have: must-arrive is for round trips")
    keys.check_name(order.run, "run")
    if len(order.run) > 40:
        raise BadInput.wrong("run", order.run, "40 characters at most")
    if len(order.asker) > 100 or not order.asker.isprintable():
        raise BadInput.wrong("asker", repr(order.asker[:100]), "100 printable characters at most")
    keys.check_name(order.peer, "peer")
    if order.peer == host:
        raise BadInput.wrong("peer", order.peer, f"another host than {host} itself")


class Run:
    """Made when it is ordered; :meth:`go` lasts as long as it does. On the event loop."""

    def __init__(self, session: zenoh.Session, fleet: str, host: str, order: BenchOrder) -> None:
        self._session, self._fleet, self._host, self.order = session, fleet, host, order
        self._began = self._asked = time.monotonic()
        self._state: BenchState = "waiting"
        self._why = ""
        self._ended: float | None = None
        self._stop = asyncio.Event()
        self._total = max(1, math.ceil(order.hz * order.seconds - 1e-9))
        self._tally = Tally(self._total, int(SECOND / order.hz), int(order.gap * SECOND))
        self._sender: Sender | None = None
        self._pingers: list[Pinger] = []
        self._tag = tag_of(order.run)
        self._qos = keys.Qos(order.qos)

    @property
    def over(self) -> bool:
        return self._ended is not None

    def word(self) -> None:
        """The asker is still there."""
        self._asked = time.monotonic()

    def stop(self) -> None:
        self._stop.set()

    def describe(self) -> str:
        """What goes on here, for somebody who would like to measure, too."""
        order, since = self.order, time.monotonic() - self._began
        who = f" for {order.asker}" if order.asker else ""
        return f"{order.role} with {order.peer}{who} since {since:.0f} s, for {order.seconds:.0f} s"

    async def go(self) -> None:
        """Until done, stopped, or forgotten by who asked for it."""
        role = {"send": self._send, "receive": self._receive, "query": self._query}[self.order.role]
        async with alongside(self._watch(), role()) as (watch, work):
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
            if time.monotonic() - self._asked > self.order.patience:
                return f"no word from who asked for it for {self.order.patience:g} s"
        return "asked to"

    async def _query(self) -> None:
        order, filling = self.order, os.urandom(self.order.size)
        pinger = Pinger(self._session, self._fleet, order.peer, self._qos, payload=filling)
        self._pingers, self._state = [pinger], "running"
        await pinger.ask_for(order.seconds, order.hz)
        await pinger.settled()

    # Datagrams.

    def _flow(self, host: str) -> str:
        return keys.BENCH_FLOW.key(self._fleet, host, run=self.order.run)

    async def _receive(self) -> None:
        with _undeclared(self._session.declare_subscriber(self._flow(self.order.peer), self._take)):
            self._state = "running"
            await asyncio.sleep(self.order.seconds + TAIL + 2.0 * FOUND_WITHIN)

    def _take(self, sample: zenoh.Sample) -> None:
        now, data = time.monotonic_ns(), sample.payload.to_bytes()
        found = read_datagram(data, self._tag)
        if found is not None:
            self._tally.take(*found, len(data), now)

    async def _send(self) -> None:
        """As the fleet's own traffic of that class travels: what the link loses is sent again but for ``bulk``."""
        order, peer, session = self.order, self.order.peer, self._session
        lane = zenoh.Reliability.BEST_EFFORT if self._qos is keys.Qos.BULK else zenoh.Reliability.RELIABLE
        made = session.declare_publisher(
            self._flow(self._host), encoding=keys.RAW, reliability=lane, **self._qos.options()
        )
        with _undeclared(made) as publisher:
            if not await _is_matched(publisher):
                self._state = "failed"
                ways = f"no way between them, or {peer} does not take part"
                self._why = f"nothing of {peer} is known at {self._host}: {ways}"
                return
            if order.guard:
                idle = Pinger(session, self._fleet, peer, keys.Qos.REALTIME)
                self._pingers = [idle]
                await idle.ask_for(FIRST_LOOKS / FIRST_HZ, FIRST_HZ)
                self._pingers.append(Pinger(session, self._fleet, peer, keys.Qos.REALTIME, clock=idle.clock))
            await self._send_with(publisher)
            await asyncio.sleep(TAIL)  # what is on its way may have to be sent again

    async def _send_with(self, publisher: Any) -> None:
        order = self.order
        self._sender = Sender(publisher.put, self._tag, hz=order.hz, size=order.size, total=self._total)
        self._state = "running"
        self._sender.start()
        async with alongside(*(pinger.ask_for(order.seconds, order.guard) for pinger in self._pingers[1:])):
            try:
                while self._sender.running:
                    await asyncio.sleep(BEAT)
            finally:
                self._sender.stop()
        if self._sender.error:
            self._state, self._why = "failed", self._sender.error

    # What there is to tell.

    def report(self, query: BenchQuery) -> BenchReport:
        order, sending, now = self.order, self._sender, time.monotonic_ns()
        return BenchReport(
            run=order.run,
            host=self._host,
            role=order.role,
            state=self._state,
            why=self._why,
            sent=sending.sent if sending else 0,
            send_seconds=sending.seconds if sending else 0.0,
            skipped=sending.skipped if sending else 0,
            lateness=sending.lateness.spread() if sending else None,
            total=self._tally.total(),
            intervals=self._tally.intervals(now, max(query.since, 0)),
            outages=self._tally.outages(max(query.outages, 0)),
            clock=next((pinger.clock.read() for pinger in self._pingers), None),
            trips=[pinger.trip() for pinger in self._pingers],
        )


@contextlib.contextmanager
def _undeclared(declared: Any) -> Iterator[Any]:
    try:
        yield declared
    finally:
        with contextlib.suppress(zenoh.ZError):  # the session may be gone before us
            declared.undeclare()


async def _is_matched(publisher: Any) -> bool:
    """Wait until somebody subscribes to what it publishes; False when nobody did within :data:`FOUND_WITHIN`."""
    known = asyncio.Event()
    found = on_loop(asyncio.get_running_loop(), known.set)
    with _undeclared(publisher.declare_matching_listener(lambda status: status.matching and found())):
        if not publisher.matching_status.matching:
            with contextlib.suppress(asyncio.TimeoutError):
                await within(FOUND_WITHIN, known.wait())
        return bool(publisher.matching_status.matching)
