"""Rates by demand: the autopilot sends what somebody reads, as fast as the fastest reader wants, and no longer.

A floor of messages (position, attitude, system status...) always flows. What flows fast enough by itself is left alone;
what was asked for is left to the autopilot again when its last reader leaves. What comes faster than it was asked for
was asked for by another station on the same link: no reader of ours slows it. Where a serial link is full, the least
wanted is slowed first (:mod:`zmav.services.rates.plan`). A rebooted autopilot has forgotten everything and is asked
again. SET_MESSAGE_INTERVAL is sent one at a time: an acknowledgement does not say for which message.
https://mavlink.io/en/mavgen_python/howto_requestmessages.html
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator, Mapping

import zenoh

from zmav import keys, wire
from zmav.autopilots import Command
from zmav.mavlink.results import CommandResult
from zmav.services.companion import Companion
from zmav.services.link.clock import AutopilotClock
from zmav.services.link.identity import VehicleChanged
from zmav.services.link.port import Inbox, is_ours
from zmav.services.queries.questions import Reply
from zmav.services.rates.demand import Demands
from zmav.services.rates.meter import WINDOW, Measured, Meter
from zmav.services.rates.plan import ENOUGH, RequestedRate, Shedder, Target, rows, wanted

OWN = {"SYSTEM_TIME": 0.2}
"""what the companion itself reads beside the floor: GPS time, for its clock"""
SET_INTERVAL = "MAV_CMD_SET_MESSAGE_INTERVAL"
DEFAULT = 0.0
"""the interval that stands for whatever the autopilot does unasked"""
SILENT = 1.2
"""s after which what is not heard, and may come by itself, is taken not to"""
ANSWER = 0.5
"""s for an acknowledgement"""
LONGEST_PAUSE = 60.0
"""s between two tries of what does not come"""
FASTER = 1.25
"""of the rate asked for, from which on somebody else has asked for more"""
SLOWER_FROM = 20.0
"""Hz; a denied rate above it is tried at half: autopilots deny what is faster than their own loop"""


class Rates:
    """Keeps one autopilot sending what is read. Lives on the event loop.

    ``needs``: what else the companion reads, in Hz: the pilot's switch. ``clock`` tells how fast a simulation goes: so
    much faster comes what it is asked for.
    """

    unanswered_pause = 3.0
    """... while it does not even answer: it may be starting"""

    def __init__(self, companion: Companion, needs: Mapping[str, float], clock: AutopilotClock) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self.meter, self.demands = Meter(companion.port), Demands(companion, self.plan)
        self._always, self._needs, self._clock = needs, dict(needs), clock
        self._shedder = Shedder(companion.port.dialect)
        self._targets: list[Target] = []
        self._standing: dict[str, RequestedRate] = {}
        self._of: tuple[int, int] | None = None
        self._was_connected, self._back_at = False, 0.0
        self._shed: set[str] = set()
        self._key = keys.RATES.key(companion.port.fleet, companion.port.name)
        self._wake = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None
        self._silent: asyncio.TimerHandle | None = None  # until what has not come by then is asked for
        companion.questions.declare(self._key, self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        yield Reply(self._key, wire.encode(self.table()), keys.RATES.encoding)

    def start(self) -> None:
        self.demands.start()
        self._port.bus.on(VehicleChanged, lambda told: self.plan())  # SILENT begins with the first HEARTBEAT
        self._worker = asyncio.get_running_loop().create_task(self._work())

    def close(self) -> None:
        """End it; what was asked for is left to the autopilot again, so that nothing flows for nobody."""
        if self._worker:
            self._worker.cancel()
        if self._silent:
            self._silent.cancel()
        floor = {target.name: target.floor for target in self._targets}
        for name, standing in self._standing.items():
            if self._others_want_more(name):
                continue
            if self._of is not None and standing.asked is not None and standing.asked > floor.get(name, 0.0):
                self._send_interval(self._of, name, 1e6 / floor[name] if floor.get(name) else DEFAULT)
        self.demands.close()

    def tick(self) -> None:
        """Once a second."""
        self.meter.tick()
        source = self._identity.source
        if source is not None:
            self.demands.poll(source)
        self.plan()

    def restarted(self) -> None:
        """The autopilot has begun again: what it was told is forgotten, and what it refused it may take now."""
        for standing in self._standing.values():
            standing.forgotten = standing.asked is not None
            standing.refused, standing.final, standing.ceiling = None, False, math.inf
            standing.not_before, standing.pause = 0.0, 1.0
        self.plan()

    # What is wanted.

    def need(self, name: str, hz: float) -> None:
        """The companion itself reads this from now on; 0: no more, but for what it always does."""
        hz = max(hz, self._always.get(name, 0.0))
        if self._needs.get(name, 0.0) == hz:
            return
        self._needs[name] = hz
        if not hz:
            del self._needs[name]
        self.plan()

    def plan(self) -> None:
        """Put together what should flow, and have it asked for."""
        source, autopilot = self._identity.source, self._identity.autopilot
        if source != self._of:
            self._of = source
            self._standing.clear()
        back = self._identity.connected and not self._was_connected
        self._was_connected = self._identity.connected
        if source is None or autopilot is None or not self._identity.connected:
            return
        if back:  # after a silence; whether it was a restart is seen by what does not flow
            self._back_at = time.monotonic()
            if self._silent:
                self._silent.cancel()
            self._silent = asyncio.get_running_loop().call_later(SILENT + 0.01, self._wake.set)
            for standing in self._standing.values():
                standing.not_before, standing.pause = 0.0, 1.0
        flows = self._flows()
        targets = wanted(autopilot.floor, {**OWN, **self._needs}, self.demands.current())
        ours = {name for name, standing in self._standing.items() if standing.asked is not None}
        self._shedder.apply(targets, flows, self.meter.used, ours, self._port.link.capacity)
        self._targets = targets
        self._say_shed()
        self._wake.set()

    def _flows(self) -> dict[str, Measured]:
        """What comes from the autopilot itself, by message."""
        return {kind[0]: m for kind, m in self.meter.measured().items() if kind[1:] == self._of}

    def _flow(self, name: str) -> Measured | None:
        return None if self._of is None else self.meter.measure((name, *self._of))

    def _say_shed(self) -> None:
        slowed = [target for target in self._targets if target.shed]
        names = {target.name for target in slowed}
        if names == self._shed:
            return
        self._shed = names
        if not names:
            self._events.emit("rate", "info", "there is room on the link: everything comes at the rate wanted")
            return
        rates = ", ".join(f"{t.name} {t.granted:.3g} of {t.hz:.3g} Hz" for t in slowed)
        capacity = self._port.link.capacity or 0.0
        text = f"the link is full ({self.meter.used:.0f} of {capacity:.0f} bytes/s): {rates}"
        self._events.emit("rate", "warning", text, limit="shed", shed=sorted(names))

    # Asking for it.

    async def _work(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                await self._settle()
            except Exception as e:
                self._events.emit("fault", "error", f"rates: {e!r}", limit="rates")

    async def _settle(self) -> None:
        """Bring the autopilot nearer to the plan, one message after the other."""
        source = self._of
        for target in list(self._targets):
            if source is None or not self._identity.connected or source != self._of:
                return
            if self._due(target):
                await self._ask(source, target)
        names = {target.name for target in self._targets}
        for name in [name for name in self._standing if name not in names]:
            if source is not None and source == self._of and self._identity.connected:
                await self._put_back(source, name)

    def _due(self, target: Target) -> bool:
        """It must be asked for, now."""
        if self._identity.autopilot is None or target.name in self._identity.autopilot.unrated:
            return False
        standing, flow = self._standing.get(target.name), self._flow(target.name)
        heard = self._port.latest(target.name, self._of) if self._of else None
        rate = target.granted if standing is None else standing.rate(target)
        if standing is None or standing.asked is None:
            if standing is not None and (standing.final or time.monotonic() < standing.not_before):
                return False
            if heard is None:
                return time.monotonic() - self._back_at > SILENT
            if standing is not None and time.monotonic() - standing.since < WINDOW + 1:
                return True
            unmeasured = flow is None or flow.span < 2.0
            # What has just begun to flow is measured first, unless it is silent again.
            return heard.age > max(SILENT, 3.0 / rate) if unmeasured else not _enough(flow, rate)
        if standing.forgotten:
            return True
        if abs(rate - standing.asked) > 0.01 * standing.asked:
            return target.shed or flow is None or rate > flow.hz or not self._others_want_more(target.name)
        fresh = heard is not None and heard.age < 3.0 / rate
        if fresh and (time.monotonic() - standing.since < WINDOW + 1 or _enough(flow, rate / 2)):
            standing.pause = 1.0
            return False
        return time.monotonic() >= standing.not_before

    def _others_want_more(self, name: str) -> bool:
        """It comes faster than we asked for, by what was measured since then."""
        flow, standing = self._flow(name), self._standing[name]
        if flow is None or standing.asked is None or time.monotonic() - standing.since < WINDOW + 1:
            return False
        return flow.hz > FASTER * standing.asked * max(1.0 - self._clock.drift, 1.0)

    async def _ask(self, source: tuple[int, int], target: Target) -> None:
        standing = self._standing.setdefault(target.name, RequestedRate())
        rate = standing.rate(target)
        had, standing.asked = standing.asked, rate  # from now on it is to be put back, whatever comes in between
        result = await self._set_interval(source, target.name, 1e6 / rate)
        standing.since, standing.forgotten = time.monotonic(), False
        standing.not_before = standing.since + standing.pause
        standing.pause = min(2.0 * standing.pause, self.unanswered_pause if result is None else LONGEST_PAUSE)
        if result is None or result == CommandResult.ACCEPTED:
            standing.refused = None  # without an answer: what flows will tell
            standing.not_before += 3.0 / rate
        else:
            standing.asked = had
            self._refuse(standing, target, result, rate)

    def _refuse(self, standing: RequestedRate, target: Target, result: int, rate: float) -> None:
        never = self._identity.autopilot is not None and result in self._identity.autopilot.never_rated
        slower = max(rate / 2, standing.asked or 0.0)  # what it sends already, it has not refused
        if never and rate > SLOWER_FROM:
            standing.ceiling, standing.not_before = slower, 0.0
            self._wake.set()
            return
        word = (self._port.dialect.enum_name("MAV_RESULT", result) or str(result)).removeprefix("MAV_RESULT_")
        if standing.refused is None:
            readers = ", ".join(target.readers)
            text = f"{target.name} at {rate:.3g} Hz refused: {word} (wanted by {readers})"
            self._events.emit("rate", "warning", text, message=target.name, result=word)
        standing.refused = word
        if standing.asked is None:
            standing.final = never
        else:
            standing.ceiling = slower

    async def _put_back(self, source: tuple[int, int], name: str) -> None:
        """Nobody reads it any more."""
        standing = self._standing[name]
        if standing.asked is None:
            # What was refused for good is remembered, and so is for a while that the measured rate tells of the past.
            if not standing.final and time.monotonic() - standing.since > WINDOW + 1:
                del self._standing[name]
            return
        if time.monotonic() < standing.not_before and standing.tries:
            return
        if not self._others_want_more(name):
            result = await self._set_interval(source, name, DEFAULT)
            standing.tries += 1
            standing.not_before = time.monotonic() + 1.0
            if result is None and standing.tries < 5:
                return
        self._standing[name] = RequestedRate(since=time.monotonic())
        self._wake.set()  # somebody may have come meanwhile

    async def _set_interval(self, source: tuple[int, int], name: str, interval: float) -> int | None:
        """Have a message sent every ``interval`` µs; the MAV_RESULT, or None where nobody answered."""
        number = self._port.dialect.value("MAV_CMD", SET_INTERVAL)
        with Inbox(self._port, source, "COMMAND_ACK") as inbox:
            self._send_interval(source, name, interval)
            deadline = time.monotonic() + ANSWER
            while (heard := await inbox.get(deadline - time.monotonic())) is not None:
                if heard[1]["command"] == number and is_ours(heard[1], self._port):
                    return int(heard[1]["result"])
        return None

    def _send_interval(self, source: tuple[int, int], name: str, interval: float) -> None:
        command = Command(SET_INTERVAL, (float(self._port.msgid(name)), interval)).message(self._port.dialect)
        self._port.send(command.name, **command.addressed(*source))

    # Statistics.

    def table(self) -> wire.RateTable:
        """What comes, what was asked for, what is wanted and by whom; in any thread."""
        measured = self.meter.measured()
        return wire.RateTable(
            t=time.time(),
            capacity=self._port.link.capacity,
            used=self.meter.used,
            junk=self.demands.junk,
            messages=rows(measured, self._of, self._targets, self._standing),
        )


def _enough(flow: Measured | None, rate: float) -> bool:
    return flow is not None and flow.hz >= ENOUGH * rate
