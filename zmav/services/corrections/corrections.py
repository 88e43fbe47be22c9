"""``@fleet/rtcm`` -> GPS_RTCM_DATA: the fleet's corrections, cut for one autopilot, at the pace of its link.

One source is in charge (:class:`zmav.corrections.Charge`); what others say meanwhile is dropped, and two bases are
never mixed.
"""

from __future__ import annotations

import asyncio
import collections
import logging
import math
import time
from collections.abc import Callable

import zenoh

from zmav import geo, keys, wire
from zmav.corrections import MOST, OLDEST_S, Batch, Charge, unpack
from zmav.errors import BadMessage, Forbidden
from zmav.formats.rtcm3 import Ecef
from zmav.mavlink.rtcm import fields
from zmav.services.companion import Companion
from zmav.services.corrections.outgoing import AROUND, Outgoing, Pace, Waiting
from zmav.services.link.port import one_waits
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached
from zmav.trust.gate import Prove
from zmav.waiting import on_loop

logger = logging.getLogger(__name__)
MOST_WAITING = 16
"""batches that are looked at in 5 ms, the newest"""
FORGET_S = 600.0
"""s after the last ones from which the state has nothing of corrections any more"""
MOVED_M = 0.5
"""m by which a base may say that it stands elsewhere: a survey-in that goes on shifts it by less"""
FAR_M = 100_000.0
"""m to a base beyond which its corrections are another place's"""
RATE_S = 5.0
"""s over which the rate in the state is taken"""


class Corrections:
    """The service of one vehicle. ``told``: :meth:`zmav.trust.gate.Gate.check_told`, or nobody looks.

    ``place``: where the vehicle is. Lives on the event loop, but for what the intake's thread does.
    """

    def __init__(self, companion: Companion, told: Prove, place: Callable[[], wire.GlobalPosition | None]) -> None:
        self._port, self._events, self._session = companion.port, companion.events, companion.session
        self._identity, self._told, self._place = companion.identity, told, place
        self._charge, self._queue = Charge[Batch](), Outgoing()
        self.pace = Pace(lambda: self._port.link.capacity)
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._intake: Intake | None = None
        self._source: Batch | None = None
        """of whom the newest were taken"""
        self._station: int | None = None
        self._base: Ecef | None = None
        self._placed = False
        """it was looked at how far the base is: the vehicle's own place may come long after the base's"""
        self._given_us: int | None = None
        """when the source had the newest observations that the autopilot was given"""
        self._sent: collections.deque[tuple[float, int]] = collections.deque()
        """monotonic seconds and bytes of what was sent of late"""
        self._silent = True
        self.silent_s = 30.0
        """s without observations from which on the vehicle says that there are none"""
        self.messages = 0
        """that the autopilot was given"""

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        hear, drop = one_waits(loop, self._hear), on_loop(loop, self._drop)

        def take(sample: zenoh.Sample) -> None:
            """In the intake's thread: what is not proven comes no further."""
            payload = sample.payload.to_bytes() if len(sample.payload) <= MOST else b""
            try:
                self._told(str(sample.key_expr), payload, attached(sample))
                hear(unpack(payload))
            except Forbidden:
                pass  # said and counted by the gate
            except BadMessage as e:
                drop("malformed")
                logger.debug("corrections that are none: %s", e)

        key = keys.RTCM.key(self._port.fleet)
        self._intake = Intake(self._session.declare_subscriber, key, take, MOST_WAITING)
        self._task = loop.create_task(self._send())

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
        if self._intake is not None:
            self._intake.close()
            self._intake = None

    # In.

    def _drop(self, reason: str, count: int = 1) -> None:
        self._queue.dropped[reason] += count

    def _hear(self, batch: Batch) -> None:
        count, age = len(batch.messages), time.time() - batch.t
        if abs(age) > OLDEST_S:
            self._drop("old" if age > 0 else "ahead", count)
            way = "old" if age > 0 else "ahead of our clock"
            text = f"corrections of {batch.source} are {abs(age):.0f} s {way}: dropped; look at the clocks and the way"
            self._events.emit("corrections", "warning", text, limit="corrections old")
            return
        if not self._charge.hear(batch, time.monotonic()):
            self._drop("standby", count)
            return
        before, self._source = self._source, batch
        if before is None or before.instance != batch.instance:
            self._queue.clear()
            self._base, self._station, self._placed = None, None, False
            if before is not None:
                text = f"corrections come from {batch.source} now, and no more from {before.source}"
                self._events.emit("corrections", "notice", text, limit="corrections source")
        elif batch.t_us < before.t_us:
            self._drop("overtaken", count)
            self._source = before
            return
        for message in batch.messages:
            self._station = self._station if message.station is None else message.station
            if message.place is not None:
                self._stand(message.place, batch)
        self._queue.put(batch)
        self._news.set()

    def _stand(self, place: Ecef, batch: Batch) -> None:
        """The base says where it is."""
        before, self._base = self._base, place
        if before is not None and (moved := before.distance(place)) > MOVED_M:
            text = f"the base of {batch.source} moved by {moved:.1f} m: positions that go by it jump as far"
            self._events.emit("corrections", "warning", text, limit="corrections moved", moved=round(moved, 2))
        baseline = self._baseline(self._place())
        if self._placed or baseline is None:
            return
        self._placed = True
        if baseline > FAR_M:
            text = f"the base of {batch.source} is {baseline / 1e3:.0f} km away: its corrections are another place's"
            self._events.emit("corrections", "warning", text, limit="corrections far", baseline=round(baseline))

    def _baseline(self, here: wire.GlobalPosition | None) -> float | None:
        if here is None or self._base is None:
            return None
        return self._base.distance(Ecef(*geo.to_ecef(here.lat_deg, here.lon_deg, here.alt_amsl)))

    # Out.

    async def _send(self) -> None:
        while True:
            self._news.clear()
            if not self._identity.source:
                self._queue.clear()  # nobody is there to take them
            while (waiting := self._queue.next(time.time())) is not None:
                await self._give(waiting)
            await self._news.wait()

    async def _give(self, waiting: Waiting) -> None:
        message = waiting.message
        for flags, piece in self._queue.pieces(message):
            while (left := self.pace.wait(time.monotonic())) > 0.0:
                await asyncio.sleep(left)
            if not self._port.send("GPS_RTCM_DATA", **fields(flags, piece)):
                self._drop("link")
                return
            now, size = time.monotonic(), len(piece) + AROUND
            self.pace.spend(size, now)
            while self._sent and now - self._sent[0][0] > RATE_S:
                self._sent.popleft()
            self._sent.append((now, size))
        self.messages += 1
        if message.observes:
            self._given_us = max(waiting.t_us, self._given_us or 0)
            if self._silent and self._source is not None:
                self._silent = False
                self._events.emit(
                    "corrections", "info", f"corrections come from {self._source.source}", limit="corrections"
                )

    def tick(self) -> None:
        """Say when they stop: the receiver goes on with the last ones for a while, and less and less exactly."""
        age = self._age()
        if not self._silent and age > self.silent_s:
            self._silent = True
            self._events.emit("corrections", "warning", f"no corrections for {age:.0f} s", limit="corrections")

    def _age(self) -> float:
        return math.inf if self._given_us is None else max(time.time() - self._given_us / 1e6, 0.0)

    def add_to_state(self, state: wire.VehicleState) -> None:
        source, age = self._source, self._age()
        if source is None or min(age, time.time() - source.t) > FORGET_S:
            return
        now, baseline = time.monotonic(), self._baseline(state.position)
        state.corrections = wire.CorrectionsInfo(
            age=None if self._given_us is None else round(age, 1),
            source=source.source,
            station=self._station,
            baseline=None if baseline is None else round(baseline),
            rate=round(sum(size for at, size in self._sent if now - at < RATE_S) / RATE_S),
            dropped={reason: count for reason, count in self._queue.dropped.items() if count},
        )
