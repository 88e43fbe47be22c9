"""``zmav tak`` as it runs: what the fleet says, put together each second and sent by pytak's connections.

What comes from there is read and thrown away: nobody is obeyed who has no credentials of the fleet.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
import warnings
from collections.abc import Callable, Mapping
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import msgspec

import zmav
from ground.program import Connecting, hear_proven, say_status
from ground.tak.cot import Cot, places_of
from zmav import keys, wire
from zmav.doctor.rules import of_state
from zmav.errors import BadInput
from zmav.waiting import cancelled, on_loop, within

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of transports that it could have, and that are not wanted
    import pytak

AGENT = "tak"
STALE_VEHICLE, STALE_WAY, STALE_ALARM = 10.0, 60.0, 60.0
"""s after which what was sent is not of now any more, or after so many times ``every``:"""
MISSED = 2.5
SLOW_S = 10.0
"""s between two times that ways and alarms are sent again where nothing has changed"""
CONNECT_S, SEND_S = 10.0, 5.0
UNSAID = 30.0
"""s after which a plan that its planner does not say again is not flown any more: it was stopped, or planned again"""
MOST_PLANS, MOST_TRACKS, LARGEST = 32, 200, 1_000_000
TLS = "PYTAK_TLS_"
"""how pytak's own settings for TLS begin, in the environment"""


class TakSettings(msgspec.Struct, frozen=True, kw_only=True):
    url: str
    name: str
    every: float = 1.0
    """s"""
    geoid: float | None = None
    tls: Mapping[str, str] = {}
    """pytak's own settings"""


class Tak(Connecting):
    """``async with Tak(z, settings, say): ...``; on the event loop."""

    def __init__(self, z: zmav.Client, settings: TakSettings, say: Callable[[str], None]) -> None:
        super().__init__(settings.url, say)
        self._z, self.settings = z, settings
        self._cots: dict[str, Cot] = {}
        self._plans: dict[tuple[str, str], tuple[wire.swarm.PlanReport, float]] = {}
        """by fleet and goal, and when it was said last"""
        self._sent_at: dict[str, float] = {}
        self._alarms: dict[tuple[str, str], str] = {}
        self.sent = self.events = self.ignored = 0
        """connections made, events sent, bytes that came and were not looked at"""

    async def __aenter__(self) -> Tak:
        hear, key = on_loop(asyncio.get_running_loop(), self._hear), keys.FLEET.key(self._z.fleet_name, topic="plan")

        def read(payload: bytes) -> wire.swarm.PlanReport:
            return wire.decode(payload, wire.swarm.PlanReport, "plan")

        def take(where: str, plan: wire.swarm.PlanReport) -> None:
            hear(keys.match(where)[1]["fleet"], plan)  # a key expression that names no fleet is refused here

        self._intake = hear_proven(self._z, key, read, take, largest=LARGEST, most=MOST_PLANS)
        work = (self.run(), say_status(self._z, AGENT, self.settings.name, self.status))
        self._tasks = [asyncio.create_task(each) for each in work]
        return self

    async def __aexit__(self, *_: object) -> None:
        await cancelled(*self._tasks)
        self._intake.close()

    def _hear(self, fleet: str, plan: wire.swarm.PlanReport) -> None:
        self._plans[fleet, plan.goal] = plan, time.monotonic()
        if len(self._plans) > MOST_PLANS:
            del self._plans[next(iter(self._plans))]

    # Out.

    def why(self, error: Exception) -> str:
        """Whatever pytak raises, the fleet is to be seen again."""
        if isinstance(error, asyncio.TimeoutError):
            return "no answer" if self.state != "up" else "it takes nothing any more"
        if isinstance(error, SyntaxError):  # as which pytak says it, in many lines
            unproven = "VERIFY" in str(error)
            return "its certificate is not believed: give --ca" if unproven else str(error).partition("\n")[0]
        return (error.strerror if isinstance(error, OSError) else None) or str(error)

    async def serve(self) -> str:
        config = ConfigParser(interpolation=None)
        config["tak"] = {"COT_URL": self.settings.url, **self.settings.tls}
        reader, writer = await within(CONNECT_S, pytak.protocol_factory(config["tak"]))
        self.sent += 1
        self._sent_at.clear()
        self.turn("up")
        streams = isinstance(writer, asyncio.StreamWriter)
        reading = asyncio.ensure_future(self._ignore(reader)) if streams else None
        try:
            while reading is None or not reading.done():
                for event in self._due(time.time()):
                    if streams:
                        writer.write(event + b"\n")
                        await within(SEND_S, writer.drain())
                    else:
                        await within(SEND_S, writer.send(event))
                    self.events += 1
                await asyncio.sleep(self.settings.every)
        finally:
            await cancelled(reading)
            writer.close()
            if not streams and reader is not None:
                reader.close()
        return "the server closed the connection"

    async def _ignore(self, reader: asyncio.StreamReader) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65_536):
                self.ignored += len(data)

    def _due(self, now: float) -> list[bytes]:
        """What is to be sent now; of a vehicle that is not heard nothing is, so that it goes stale there."""
        found: list[bytes | None] = []
        for vehicle in self._z.fleet():
            state, age = vehicle.last_state, vehicle.age
            if state is None or age is None or age > (keys.STATE.stale_after or 0.0):
                continue
            cot = self._cots.setdefault(vehicle.fleet, Cot(vehicle.fleet, self.settings.geoid))
            lasts = MISSED * self.settings.every
            found.append(cot.vehicle(state, now, max(STALE_VEHICLE, lasts)))
            bad = "; ".join(reason.text for reason in of_state(state) if reason.level == "bad")
            place = (vehicle.fleet, vehicle.name)
            if bad or self._alarms.get(place):
                if self._alarms.get(place, "") != bad or self._is_due(f"alarm {place}"):
                    found.append(cot.alarm(state, bad, now, max(STALE_ALARM, lasts)))
                self._alarms[place] = bad
            plan = self._plan_of(vehicle.fleet, vehicle.name, now)
            if plan is not None and self._is_due(f"{place} {plan.goal} {plan.start}"):
                track = places_of(state, plan.tracks[vehicle.name][:MOST_TRACKS])
                found += cot.way(vehicle.name, plan.goal, track, now, max(STALE_WAY, lasts))
        return [event for event in found if event is not None]

    def _plan_of(self, fleet: str, name: str, now: float) -> wire.swarm.PlanReport | None:
        """What it flies: of those that are said and not over the one that began last."""
        said = time.monotonic() - UNSAID
        plans = [plan for (of, _), (plan, at) in self._plans.items() if of == fleet and at > said]
        mine = [plan for plan in plans if plan.tracks.get(name) and now <= plan.start + plan.makespan]
        return max(mine, key=lambda plan: plan.start, default=None)

    def _is_due(self, what: str) -> bool:
        now = time.monotonic()
        if now - self._sent_at.get(what, now - SLOW_S) < SLOW_S:
            return False
        self._sent_at = {each: at for each, at in self._sent_at.items() if now - at < SLOW_S}
        self._sent_at[what] = now
        return True

    def status(self) -> tuple[str, str, dict[str, Any]]:
        """A word, a sentence and the details, as the status has them."""
        text = self.text or f"{self.events} events to {self.settings.url}"
        alarms = [name for (_, name), text in self._alarms.items() if text]
        return self.state, text, {"events": self.events, "connections": self.sent, "alarms": alarms}


def tls_of(cert: str | None, key: str | None, ca: str | None) -> dict[str, str]:
    """pytak's settings: those of the environment, and these files."""
    given = {"CLIENT_CERT": cert, "CLIENT_KEY": key, "CLIENT_CAFILE": ca}
    for name, file in given.items():
        if file is not None and not Path(file).is_file():
            field = {"CLIENT_CERT": "cert", "CLIENT_KEY": "key", "CLIENT_CAFILE": "ca"}[name]
            raise BadInput(f"no file {file}", field=field, value=file, expected="a PEM file")
    own = {name: value for name, value in os.environ.items() if name.startswith(TLS)}
    found = own | {TLS + name: file for name, file in given.items() if file is not None}
    if not found.get(f"{TLS}CLIENT_CERT"):
        text = "a TAK server by TLS is shown a certificate of ours: give --cert"
        raise BadInput(text, field="cert", value=None, expected="a PEM file")
    return found
