"""Round trips by query, and what they tell of the other host's clock."""

from __future__ import annotations

import asyncio
import time

import zenoh

from mesh.bench.statistics import SECOND, Samples
from zmav import keys, wire
from zmav.direct import direct
from zmav.errors import BadInput
from zmav.waiting import on_loop
from zmav.wire.bench import BenchClock, BenchTrip, Pong

TIMEOUT = 2.0
DRIFT = 50e-6
"""s a second by which two quartz clocks part at most: twice what one of them is usually sold with"""


class Clock:
    """Another host's clock less ours, from exchanges of four times (RFC 5905, section 8: offset and delay)."""

    def __init__(self) -> None:
        self._best: tuple[float, float, float] | None = None
        self._utc = 0.0

    def add(self, left_ns: int, pong: Pong, back_ns: int, utc: float) -> float:
        """One exchange, ``utc`` being ours when the answer came; the round trip in s without the other's own time."""
        there = (pong.left_ns - pong.came_ns) / SECOND
        trip = max((back_ns - left_ns) / SECOND - there, 0.0)
        offset = ((pong.came_ns - left_ns) + (pong.left_ns - back_ns)) / 2.0 / SECOND
        at = back_ns / SECOND
        if self._best is None or trip / 2.0 <= self._within(at):
            self._best = (offset, trip / 2.0, at)
            self._utc = pong.t + trip / 2.0 - utc
        return trip

    def _within(self, now: float) -> float:
        assert self._best is not None
        return self._best[1] + DRIFT * (now - self._best[2])

    def read(self) -> BenchClock | None:
        """None while nobody has answered."""
        if self._best is None:
            return None
        return BenchClock(offset=self._best[0], within=self._within(time.monotonic_ns() / SECOND), utc_offset=self._utc)


class Pinger:
    """Asks one host over and over. On the event loop; the times are taken on Zenoh's threads."""

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        peer: str,
        qos: keys.Qos,
        *,
        clock: Clock | None = None,
        payload: bytes | None = None,
    ) -> None:
        self._session, self._key, self._options = session, keys.BENCH_PING.key(fleet, peer), qos.options()
        self._payload = payload
        self.peer, self.clock = peer, clock or Clock()
        self._trips = Samples()
        self._sent = self._settled = self._answered = 0
        self._news = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._over = on_loop(self._loop, self._settle)

    def ask(self) -> None:
        """Send one."""
        left = time.monotonic_ns()
        self._sent += 1

        def on_reply(reply: zenoh.Reply) -> None:
            back, utc = time.monotonic_ns(), time.time()
            if reply.ok is None:
                return
            try:
                pong = wire.decode(reply.ok.payload.to_bytes(), Pong, "pong")
            except BadInput:
                return
            self._trips.add(int(self.clock.add(left, pong, back, utc) * SECOND))
            self._answered += 1

        # Straight on Zenoh's thread: handing over to another would be part of the time.
        self._session.get(
            self._key, direct(on_reply, self._over), payload=self._payload, timeout=TIMEOUT, **self._options
        )

    def _settle(self) -> None:
        """A query is over, answered or not."""
        self._settled += 1
        self._news.set()

    async def ask_for(self, seconds: float, hz: float) -> None:
        """Ask at ``hz`` for ``seconds``."""
        start, count = self._loop.time(), max(1, round(seconds * hz))
        for number in range(count):
            await asyncio.sleep(max(start + number / hz - self._loop.time(), 0.0))
            self.ask()

    async def settled(self) -> None:
        """Wait until no answer is outstanding."""
        while self._settled < self._sent:
            self._news.clear()
            await self._news.wait()

    def trip(self) -> BenchTrip:
        lost = max(self._settled - self._answered, 0)
        return BenchTrip(peer=self.peer, sent=self._sent, lost=lost, rtt=self._trips.spread())
