"""Beside every router: answers pings, and takes its part in a measurement where an operator asks for it.

One at a time a host. A run ends after its time, when it is told to, and when who asked for it says no more; what it
measured can be asked for until the next one begins.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

import zenoh

from mesh.bench.run import Run, check
from mesh.plan import RouterPlan
from zmav import keys, wire
from zmav.errors import BadInput, Refused
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import Answers, attached
from zmav.services.queries.questions import Channel, Questions, Reply, Steps
from zmav.trust.gate import Gate, Origin, Prove, anybody
from zmav.trust.roster import Roster
from zmav.waiting import cancelled
from zmav.wire.bench import BenchOrder, BenchQuery, BenchReport, BenchStop, Pong

MOST_WAITING = 64
"""questions that are looked at in 5 ms, the newest"""
Work = Callable[[str, bytes], BenchReport]


class Responder:
    """The part of :class:`mesh.router.Router` that measures: one host's runs. On the event loop; what is asked waits in
    a lane of its own, bounded, and is proven there, so that no flood of it reaches the loop. Pings have a thread: their
    answer is part of what is timed.
    """

    def __init__(self, session: zenoh.Session, plan: RouterPlan) -> None:
        self._session, self._plan = session, plan
        self._fleet, self._host, self._zid = plan.fleet, plan.name, str(session.info.zid())
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None
        self.questions = Questions(session, Answers(None, None), anybody)
        self._gate = Gate(plan.credentials) if plan.credentials else None

    async def __aenter__(self) -> Responder:
        loop = asyncio.get_running_loop()

        def channel(prove: Prove, work: Work) -> Channel:
            return self.questions.channel(lambda query: _answer(query, prove, work, loop))

        lanes = {"order": channel(self._prove, self._ordered), "report": channel(anybody, self._reported)}

        def sort(query: zenoh.Query) -> None:
            came = time.monotonic_ns()
            *_, what, name = str(query.key_expr).split("/")
            if name == "ping":
                self._pong(query, came)
            elif what in lanes and "*" not in name:
                self.questions.put(lanes[what], query)
            else:
                query.drop()  # somebody looks around with a wildcard: that is no order

        # One queryable is cheaper than three.
        key = f"{keys.ROOT}/{self._fleet}/{self._host}/bench/**"
        self._intake = Intake(self._session.declare_queryable, key, sort, MOST_WAITING)
        return self

    def take_roster(self, roster: Roster) -> None:
        """The newest that our router has been told; older ones change nothing."""
        if self._gate is not None:
            self._gate.roster = roster

    async def __aexit__(self, *_: object) -> None:
        self.questions.close()
        self._intake.close()
        await cancelled(self._task)

    @property
    def busy(self) -> Run | None:
        """The run under way."""
        run = self._run
        return None if run is None or run.over else run

    def _pong(self, query: zenoh.Query, came: int) -> None:
        busy = self.busy
        pong = Pong(
            host=self._host,
            zid=self._zid,
            came_ns=came,
            left_ns=time.monotonic_ns(),
            t=time.time(),
            busy=busy.describe() if busy else "",
        )
        with contextlib.suppress(zenoh.ZError), query:  # who asked may be gone
            query.reply(keys.BENCH_PING.key(self._fleet, self._host), wire.encode(pong), encoding=keys.JSON)

    def _prove(self, key: str, payload: bytes, attachment: bytes | None) -> Origin | None:
        """Raise :class:`~zmav.errors.Forbidden` for an order that is not an operator's, where we can tell."""
        return None if self._gate is None else self._gate.check(key, payload, attachment)

    def _ordered(self, name: str, payload: bytes) -> BenchReport:
        if name == "start":
            return self._begin(wire.decode(payload, BenchOrder, "bench/order/start"))
        if name == "stop":
            run = self._known(wire.decode(payload, BenchStop, "bench/order/stop").run)
            run.stop()
            return run.report(BenchQuery())
        raise BadInput(f"no order {name!r}; there are start, stop", field="order", value=name, expected="start, stop")

    def _begin(self, order: BenchOrder) -> BenchReport:
        check(order, self._host)
        run = self._run
        if run is None or run.order.run != order.run:
            if run is not None and not run.over:
                text = f"{self._host} measures already: {run.describe()}"
                raise Refused(text, host=self._host, busy=run.describe())
            run = self._run = Run(self._session, self._fleet, self._host, order)
            self._task = asyncio.get_running_loop().create_task(run.go())
        elif run.order != order:
            raise BadInput(f"the run {order.run!r} is another one", field="run", value=order.run)
        run.word()
        return run.report(BenchQuery())

    def _reported(self, name: str, payload: bytes) -> BenchReport:
        run = self._known(name)
        run.word()
        return run.report(wire.decode(payload, BenchQuery, "bench/report"))

    def _known(self, name: str) -> Run:
        if self._run is None or self._run.order.run != name:
            raise Refused(f"{self._host} knows of no run {name!r}: it may have restarted", host=self._host)
        return self._run


def _answer(query: zenoh.Query, prove: Prove, work: Work, loop: asyncio.AbstractEventLoop) -> Steps:
    """In the lane; ``work`` is done on the event loop."""
    asked, payload = str(query.key_expr), query.payload.to_bytes() if query.payload else b""
    prove(asked, payload, attached(query))

    async def done() -> BenchReport:
        return work(asked.rpartition("/")[2], payload)

    yield (report := asyncio.run_coroutine_threadsafe(done(), loop))
    yield Reply(asked, wire.encode(report.result()))
