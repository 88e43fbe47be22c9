"""Beside every router: answers pings, and takes its part in a measurement where an operator asks for it.

One at a time a host. A run ends after its time, when it is told to, and when who asked for it says no more; what it
measured can be asked for two minutes longer.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

import zenoh
from zenoh import handlers

from mesh.bench.run import Run, check
from mesh.bench.units import bits_per_second
from mesh.plan import RouterPlan
from zmav import keys, wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.services.port import on_loop
from zmav.wire.bench import BenchOrder, BenchQuery, BenchReport, BenchStop, Pong

KEPT, KEPT_FOR = 8, 120.0
"""runs that are over whose reports can be had, and s for which they can"""


@contextlib.asynccontextmanager
async def responder(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[Responder]:
    """The part of :class:`mesh.router.Router` that measures."""
    found = Responder(session, plan)
    found.start()
    try:
        yield found
    finally:
        await found.close()


class Responder:
    """One host's runs. On the event loop; pings are answered on Zenoh's thread."""

    def __init__(self, session: zenoh.Session, plan: RouterPlan) -> None:
        self._session, self._plan = session, plan
        self._fleet, self._host, self._zid = plan.fleet, plan.name, str(session.info.zid())
        self._runs: dict[str, Run] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._queryables: list[Any] = []
        self._budget = budget_of(plan)

    def start(self) -> None:
        loop, fleet, host = asyncio.get_running_loop(), self._fleet, self._host
        ping: Any = handlers.Callback(self._pong, indirect=False)  # its time is part of the round trip
        self._queryables = [
            self._session.declare_queryable(keys.BENCH_PING.key(fleet, host), ping),
            self._session.declare_queryable(keys.BENCH.key(fleet, host, order="*"), on_loop(loop, self._on_order)),
            self._session.declare_queryable(
                keys.BENCH_REPORT.key(fleet, host, run="*"), on_loop(loop, self._on_report)
            ),
        ]

    async def close(self) -> None:
        for queryable in self._queryables:
            with contextlib.suppress(zenoh.ZError):
                queryable.undeclare()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    @property
    def busy(self) -> Run | None:
        """The run under way."""
        return next((run for run in tuple(self._runs.values()) if not run.over), None)

    def _pong(self, query: zenoh.Query) -> None:
        came = time.monotonic_ns()
        with query:
            busy = self.busy
            pong = Pong(
                host=self._host, zid=self._zid, came_ns=came, left_ns=time.monotonic_ns(), t=time.time(),
                busy=busy.describe() if busy else "", budget=self._budget,
            )  # fmt: skip
            query.reply(keys.BENCH_PING.key(self._fleet, self._host), wire.encode(pong), encoding=keys.JSON)

    def _on_order(self, query: zenoh.Query) -> None:
        self._answer(query, keys.BENCH.key(self._fleet, self._host, order="*"), self._ordered)

    def _on_report(self, query: zenoh.Query) -> None:
        self._answer(query, keys.BENCH_REPORT.key(self._fleet, self._host, run="*"), self._reported)

    def _answer(self, query: zenoh.Query, key: str, work: Any) -> None:
        asked = str(query.key_expr)
        if "*" in asked:
            query.drop()  # somebody looks around with a wildcard: that is no order
            return
        with query:
            try:
                report = work(asked.rpartition("/")[2], query)
            except ZmavError as e:
                query.reply_err(wire.error_body(e), encoding=keys.JSON)
            else:
                query.reply(key.replace("*", asked.rpartition("/")[2]), wire.encode(report), encoding=keys.JSON)

    def _ordered(self, name: str, query: zenoh.Query) -> BenchReport:
        payload = query.payload.to_bytes() if query.payload else b""
        if name == "start":
            return self._begin(wire.decode(payload, BenchOrder, "bench/start"))
        if name == "stop":
            run = self._known(wire.decode(payload, BenchStop, "bench/stop").run)
            run.stop()
            return run.report(BenchQuery())
        raise BadInput(f"no order {name!r}; there are start, stop", field="order", value=name, expected="start, stop")

    def _begin(self, order: BenchOrder) -> BenchReport:
        check(order, self._host)
        self._forget()
        known = self._runs.get(order.run)
        if known is None:
            if (busy := self.busy) is not None:
                text = f"{self._host} measures already: {busy.describe()}"
                raise Refused(text, host=self._host, busy=busy.describe())
            known = self._runs[order.run] = Run(self._session, self._fleet, self._host, order)
            task = asyncio.get_running_loop().create_task(known.go())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        elif known.order != order:
            raise BadInput(f"the run {order.run!r} is another one", field="run", value=order.run)
        known.word()
        return known.report(BenchQuery())

    def _reported(self, name: str, query: zenoh.Query) -> BenchReport:
        payload = query.payload.to_bytes() if query.payload else b""
        run = self._known(name)
        run.word()
        return run.report(wire.decode(payload, BenchQuery, "bench-report"))

    def _known(self, name: str) -> Run:
        run = self._runs.get(name)
        if run is None:
            raise Refused(f"{self._host} knows of no run {name!r}: it may have restarted", host=self._host)
        return run

    def _forget(self) -> None:
        over = [name for name, run in self._runs.items() if run.over]
        for number, name in enumerate(over):
            if number < len(over) - KEPT or self._runs[name].age > KEPT_FOR:
                del self._runs[name]


def budget_of(plan: RouterPlan) -> float | None:
    """Bytes a second: the smallest budget among the host's radios; None where none has one."""
    found = [bits_per_second(radio.budget, "budget") / 8.0 for radio in plan.host.radios if radio.budget]
    return min(found, default=None)
