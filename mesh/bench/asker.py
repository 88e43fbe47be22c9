"""Who asks: finds the two hosts, tells each its part, follows both, and puts together what they saw.

async with zmav.open() as z:
    flow = await Bench(z).stream("quad1", "quad2", Stream(seconds=20.0, hz=125.0, size=1000))
    print(flow.total.jitter)
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import platform
import secrets
from collections.abc import AsyncIterator
from typing import NamedTuple

import msgspec
import zenoh

from mesh.bench.flow import GIVE_UP, POLL, TRIES, Flow, Follow, OnInterval, OnOutage, Stream, pause
from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import BadInput, Clash, Forbidden, NoSuchVehicle, Refused, SessionError, TimedOut, ZmavError
from zmav.wire.bench import BenchOrder, BenchQuery, BenchReport, BenchRole, BenchStop, BenchTrip, Pong

HERE = "here"
ANSWER = 1.0
"""s to wait for an answer before it is asked again"""
LOOK = 0.3
"""s before we look again for a host that is not there"""
AGAIN = ("epoch", "unknown", "busy")
"""reasons of a refusal that another proof of origin mends"""


class _Part(NamedTuple):
    host: str
    order: BenchOrder


class Bench:
    """Measurements between hosts of one fleet, through a client of any of its routers."""

    def __init__(self, client: Client) -> None:
        if client.fleet_name == "*":
            raise BadInput("measure in one fleet: name it", field="fleet", value="*", expected="a fleet's name")
        self.client, self._fleet = client, client.fleet_name
        self._asker = f"{os.environ.get('USER', 'somebody')}@{platform.node()}"  # for a person who is refused

    # Who is there.

    async def everyone(self) -> list[Pong]:
        """Every host that answers within a second, by name."""
        key, session = keys.BENCH_PING.key(self._fleet, "*"), self.client.session
        options = {**keys.BENCH_PING.qos.options(), "consolidation": zenoh.ConsolidationMode.NONE}  # namesakes, too

        def ask() -> list[zenoh.Reply]:
            return list(session.get(key, timeout=ANSWER, **options))

        found = [_pong(reply) for reply in await asyncio.to_thread(ask)]
        return sorted((pong for pong in found if pong), key=lambda pong: pong.host)

    async def find(self, name: str) -> Pong:
        """The host of that name, or ours for ``here``; raises :class:`NoSuchVehicle` naming those there are."""
        zids = [str(zid) for zid in self.client.session.info.routers_zid()]
        if name != HERE:
            keys.check_name(name, "host")
        for _ in range(TRIES):
            present = await self.everyone()
            found = [pong for pong in present if (pong.zid in zids if name == HERE else pong.host == name)]
            if len({pong.zid for pong in found}) > 1:
                raise Clash(f"{len(found)} hosts are named {name}: which is meant?", host=name)
            if found:
                return found[0]
            await asyncio.sleep(LOOK)
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
        self,
        a: str,
        b: str,
        stream: Stream,
        *,
        until: asyncio.Event | None = None,
        on_interval: OnInterval | None = None,
        on_outage: OnOutage | None = None,
    ) -> Flow:
        """Have ``a`` send to ``b``. Ends early when ``until`` is set. Raises what a host refuses."""
        first, second = (pong.host for pong in await self.pair(a, b))
        order = msgspec.structs.replace(self._order("receive", first, stream), gap=stream.silence)
        send = msgspec.structs.replace(order, role="send", peer=second, guard=stream.guard)
        async with self._running([_Part(second, order), _Part(first, send)]) as (receiver, sender):
            flow = Flow(stream=stream, source=first, target=second, sender=sender, receiver=receiver)
            await Follow(self.report, self._stop, flow, on_interval, on_outage).to_the_end(until)
        return flow

    async def round_trips(self, a: str, b: str, stream: Stream, *, until: asyncio.Event | None = None) -> BenchTrip:
        """Round trips by query from ``a`` to ``b``."""
        order = self._order("query", b, stream)
        async with self._running([_Part(a, order)]):
            (trip,) = (await self._until_over(a, order.run, stream.seconds, until)).trips
            return trip

    def _order(self, role: BenchRole, peer: str, stream: Stream) -> BenchOrder:
        return BenchOrder(
            run=secrets.token_hex(4),
            role=role,
            peer=peer,
            seconds=stream.seconds,
            hz=stream.hz,
            size=stream.size,
            qos=stream.qos,
            patience=stream.patience,
            asker=self._asker,
        )

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
            await pause(POLL, until)

    # Orders.

    @contextlib.asynccontextmanager
    async def _running(self, parts: list[_Part]) -> AsyncIterator[list[BenchReport]]:
        """Each host's part begun, and ended whatever happens; the first answers."""
        begun: list[str] = []
        try:
            reports = []
            for host, order in parts:
                begun.append(host)
                reports.append(await self.tell(host, "start", order))
            yield reports
        finally:
            run = parts[0].order.run
            await asyncio.shield(asyncio.gather(*(self._stop(host, run) for host in begun)))

    async def _stop(self, host: str, run: str) -> None:
        with contextlib.suppress(ZmavError):  # it ends by itself, then: nobody asks for its report any more
            await self.tell(host, "stop", BenchStop(run=run), tries=2)

    async def tell(self, host: str, order: str, payload: msgspec.Struct, tries: int = TRIES) -> BenchReport:
        key = keys.BENCH.key(self._fleet, host, order=order)
        return await self._answer(host, key, wire.encode(payload), keys.BENCH, tries)

    async def report(self, host: str, run: str, *, since: int = 0, outages: int = 0, tries: int = 1) -> BenchReport:
        """What a host has to tell of a run; raises :class:`TimedOut` where it does not answer."""
        key = keys.BENCH_REPORT.key(self._fleet, host, run=run)
        query = BenchQuery(since=since, outages=outages)
        return await self._answer(host, key, wire.encode(query), keys.BENCH_REPORT, tries)

    async def _answer(self, host: str, key: str, payload: bytes, channel: keys.Channel, tries: int) -> BenchReport:
        refused: Forbidden | None = None
        loop = asyncio.get_running_loop()
        for number in range(tries):
            begun = loop.time()
            for answer in await self.client.ask(key, payload, ANSWER, channel, enough=lambda _: True):
                if isinstance(answer, Answer):
                    return wire.decode(answer.payload, BenchReport, f"report of {host}")
                if not isinstance(answer, Forbidden) or answer.detail.get("reason") not in AGAIN:
                    raise answer
                refused = answer
            if refused is None and number + 1 < tries:  # where no way is known, Zenoh says at once that nobody answers
                await asyncio.sleep(max(begun + ANSWER - loop.time(), 0.0))
        if refused is not None:
            raise refused
        raise TimedOut(f"{host} does not answer", host=host)


def _pong(reply: zenoh.Reply) -> Pong | None:
    try:
        return wire.decode(reply.ok.payload.to_bytes(), Pong, "pong") if reply.ok is not None else None
    except BadInput:
        return None
