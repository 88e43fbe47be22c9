"""``zmav traffic`` as it runs: feeds in, one report a second out while no other process with the same feeds is in
charge, and a picture of what all sources tell.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from typing import Any

import msgspec
import zenoh

import zmav
from ground.air import Listener
from ground.traffic.feeds import Feed, FeedSource
from zmav import keys, wire
from zmav.corrections import Charge
from zmav.errors import BadConfig
from zmav.traffic import CURRENT_S, LATE_S, LONGEST_NAME, Tracks
from zmav.waiting import cancelled

AGENT = "traffic"
PERIOD_S = 1.0
LISTEN_S = 2.5
"""s for which a process that has just begun listens whether another is in charge"""
SILENT_S = 10.0
"""s without a message of an aircraft, after which a feed that is connected is said to be silent"""
REACH_M = 50_000.0
LOOPBACK = ("localhost", "127.0.0.1", "::1")


class TrafficSettings(msgspec.Struct, frozen=True, kw_only=True):
    feeds: tuple[Feed, ...]
    name: str
    """the host under whose name the status is"""
    at: tuple[float, float] | None = None
    """a place about which traffic is wanted, beside the vehicles'"""
    reach: float = REACH_M
    """m"""
    qnh: float | None = None
    """hPa"""
    ours: tuple[int, ...] = ()
    """addresses of vehicles of the fleet that send ADS-B themselves"""
    priority: int = 0

    @property
    def serves(self) -> str:
        """The feeds, by names that mean the same everywhere."""
        mine = (self.name if feed.host in LOOPBACK else feed.host for feed in self.feeds)
        words = sorted(f"{feed.kind}:{host}:{feed.port}" for feed, host in zip(self.feeds, mine, strict=True))
        return " ".join(words)


class TrafficProgram:
    """``async with TrafficProgram(z, settings, say): ...``; on the event loop. Raises :class:`BadConfig` where no fleet
    is named, and :class:`Forbidden` where our role may not.
    """

    clock = staticmethod(time.monotonic)

    def __init__(self, z: zmav.Client, settings: TrafficSettings, say: Callable[[str], None]) -> None:
        if z.fleet_name == "*" or keys.is_replay(z.fleet_name):
            text = f"traffic is told to one fleet, not to {z.fleet_name!r}: name it with --fleet"
            raise BadConfig(text, field="fleet", value=z.fleet_name, expected="one fleet")
        if len(settings.name) + len(settings.serves) > LONGEST_NAME:
            text = "more feeds than a report can name: give some of them to another process"
            raise BadConfig(text, field="feeds", value=len(settings.feeds), expected=f"{LONGEST_NAME} characters")
        self._z, self.settings, self._say = z, settings, say
        self._key = keys.TRAFFIC.key(z.fleet_name)
        if z.member is not None:
            z.member.check_role(self._key)
        self.tracks = Tracks(ours=settings.ours)
        self.sources = [FeedSource(feed, self.tracks, say, self.clock) for feed in settings.feeds]
        self.listener = Listener(z, self._hear_other)
        self._instance = random.getrandbits(32)
        self._charge = Charge[wire.Traffic](CURRENT_S)
        self._speaks_at, self._since = self.clock() + LISTEN_S, 0.0
        self.stands_by_for = ""
        """which other process is in charge; empty: none"""
        self.told = 0
        """aircraft in the last report"""
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> TrafficProgram:
        self.listener.__enter__()
        self._publisher = self._z.session.declare_publisher(self._key, **keys.TRAFFIC.publishing())
        work = [self._tell(), *(source.run() for source in self.sources)]
        self._tasks = [asyncio.create_task(each) for each in work]
        return self

    async def __aexit__(self, *_: object) -> None:
        await cancelled(*self._tasks)
        self.listener.__exit__()
        self._publisher.undeclare()

    def _hear_other(self, report: wire.Traffic) -> None:
        own = report.instance == self._instance or report.serves != self.settings.serves
        if not own and abs(time.time() - report.t) <= LATE_S:
            self._charge.hear(report, self.clock())

    async def _tell(self) -> None:
        failure = ""
        while True:
            before, failure = failure, ""
            try:
                self._report()
                state, text, detail = self.status()
                self._z.say_status(AGENT, state, text, vehicle=self.settings.name, **detail)
            except (zmav.errors.ZmavError, zenoh.ZError) as e:  # no router at present
                failure = f"not told: {e}"
                if failure != before:
                    self._say(failure)
            await asyncio.sleep(PERIOD_S)

    def _report(self) -> None:
        settings, now, utc = self.settings, self.clock(), time.time()
        report = wire.Traffic(
            t=utc,
            source=settings.name,
            instance=self._instance,
            serves=settings.serves,
            priority=settings.priority,
            since=self._since or utc,
            qnh=settings.qnh,
        )
        other = self._charge.of(now)
        if other is not None and other.rank > report.rank:
            if self.stands_by_for != other.source:
                self._say(f"stands by: {other.source} is in charge")
            self._since, self.stands_by_for = 0.0, other.source
            return
        if now < self._speaks_at:
            return
        if all(source.state != "up" for source in self.sources):  # another may hear these feeds still
            self._since = 0.0
            return
        if not self._since:
            self._say(f"in charge: traffic goes to the fleet as {settings.name}")
        self._since, self.stands_by_for = report.since, ""
        states = [vehicle.last_state for vehicle in self._z.fleet()]
        places = [(s.position.lat_deg, s.position.lon_deg) for s in states if s is not None and s.position is not None]
        self.tracks.tell(report, [*places, *([settings.at] if settings.at else [])], settings.reach, now)
        self.told = len(report.aircraft)
        self._z.put(keys.TRAFFIC, self._key, report, publisher=self._publisher)

    def status(self) -> tuple[str, str, dict[str, Any]]:
        """A word, a sentence and the details, as the status has them."""
        now, tracks = self.clock(), self.tracks
        placed = tracks.placed(now)
        age = now - tracks.heard if tracks.heard else None
        lost = [source for source in self.sources if source.state != "up"]
        if lost:
            state, text = (
                "lost" if len(lost) == len(self.sources) else "partly",
                f"{lost[0].feed.words}: {lost[0].text}",
            )
        elif age is None or age > SILENT_S:
            state, text = "silent", "no aircraft is heard"
        elif self.stands_by_for:
            state, text = "standby", f"{self.stands_by_for} is in charge"
        else:
            state = "in-charge"
            unplaced = f"{len(tracks) - placed} of {len(tracks)} without position"
            text = f"{self.told} aircraft told of, {unplaced}, {age:.0f} s old"
        detail: dict[str, Any] = {
            "feeds": [
                {
                    "feed": source.feed.words,
                    "state": source.state,
                    "age": round(now - source.heard, 1) if source.heard else None,
                    "skipped": source.skipped,
                }
                for source in self.sources
            ],
            "age": None if age is None else round(age, 1),
            "aircraft": self.told,
            "heard": len(tracks),
            "placed": placed,
            "refused": dict(tracks.refused),
            "qnh": self.settings.qnh,
            "standby_for": self.stands_by_for or None,
        }
        return state, text, detail
