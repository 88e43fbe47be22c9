"""Probing each router that ours is linked to: over that link, and no other.

A router listens on ``@probe/{its own id}/*``, a key that nobody else answers, and Zenoh sends what is for a neighbour
straight to it: who gives links weights of his own (``transport_weights``) so that a way around is the shorter one
measures that way. A neighbour's name comes with the certificate by which its link was opened, or else with the key of
what it sends.

Where a link loses, words without content go beside the probes, on the lanes of what must arrive, each on the next one:
see ``LANES``.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from mesh.quality.interface import interface_to
from mesh.quality.meter import SOURCE, Meter, unpack
from zmav import keys
from zmav.direct import direct
from zmav.errors import BadInput
from zmav.waiting import cancelled

KEEP = 60.0
"""s for which a neighbour that went away is still told of"""
MOST_WAITING = 4096
"""probes that wait for the next turn; of a flood the oldest go"""
LANES = tuple(
    getattr(zenoh.Priority, name)
    for name in (
        "REAL_TIME",
        "INTERACTIVE_HIGH",
        "INTERACTIVE_LOW",
        "DATA_HIGH",
        "DATA",
        "DATA_LOW",
        "BACKGROUND",
    )
)
"""of what must arrive: QUIC has a stream for each. A link is lost when nothing came of it for a lease, and Zenoh's own
words all take one stream, where a datagram that is lost holds up each word behind it until it has come again. On seven
streams a loss holds up every seventh word; see ``mesh/profiles.py`` for what that is worth"""
WORDS = 10
"""within a lease"""
STAMP_BYTES = 120
"""of a probe on the wire, IP and UDP headers included, over ``udp/``"""


@dataclass(frozen=True)
class Pace:
    """What probes may cost: with one neighbour and no budget 0.5 kB/s each way."""

    period: float = 0.25
    """s between probes at best"""
    slowest: float = 5.0
    """s between probes at worst"""
    per_host: float = 24.0
    """probes a second to all neighbours together"""
    share: float = 0.01
    """of a budget, for probes to all neighbours"""
    look: float = 0.5
    """s between looks at the router's links"""

    def every(self, neighbours: int, budget: float | None) -> float:
        """s between probes to each of so many neighbours over a link with a budget in bytes/s."""
        often = max(self.period, neighbours / self.per_host)
        if budget:
            often = max(often, neighbours * STAMP_BYTES / (self.share * budget))
        return min(often, self.slowest)


@dataclass
class Neighbour:
    """A router that ours is linked to, or was within the last minute."""

    zid: str
    meter: Meter
    since: float
    """monotonic s since when it is linked, or not"""
    linked: bool = True
    name: str | None = None
    proven: bool = False
    """the name is that of the certificate by which the link was opened"""
    url: str = ""
    interface: str | None = None
    next_probe: float = 0.0
    next_word: float = 0.0
    lane: int = 0
    publisher: zenoh.Publisher | None = None

    def close(self) -> None:
        if self.publisher is not None:
            with contextlib.suppress(zenoh.ZError):  # the session may be closed
                self.publisher.undeclare()
        self.publisher = None


class Prober:
    """Measures the neighbours of one router's session. On the event loop; ``start`` it and ``close`` it."""

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        name: str,
        pace: Pace | None = None,
        budget: Callable[[str | None], float | None] = lambda interface: None,
        lease: float = 1.0,
    ) -> None:
        """``lease``: s, what the session was opened with."""
        self._session, self._fleet, self._name = session, fleet, name
        self._word_s = lease / WORDS
        self._pace, self._budget = pace or Pace(), budget
        self.zid = str(session.info.zid())
        self.neighbours: dict[str, Neighbour] = {}
        """by the id of their routers"""
        self.refused = 0
        """probes that were none, or of nobody we are linked to"""
        self._came: collections.deque[tuple[float, zenoh.Sample]] = collections.deque(maxlen=MOST_WAITING)
        self._subscriber: Any = None
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            if len(sample.payload):  # a word tells Zenoh enough by coming
                self._came.append((time.monotonic(), sample))

        # Straight on Zenoh's thread, so that the time is that of the arrival.
        key = keys.PROBE.key(self._fleet, "*", to=self.zid)
        self._subscriber = self._session.declare_subscriber(key, direct(on_sample))
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        await cancelled(self._task)
        with contextlib.suppress(zenoh.ZError):
            self._subscriber.undeclare()
        for neighbour in self.neighbours.values():
            neighbour.close()

    async def _run(self) -> None:
        looked = float("-inf")
        while True:
            now = time.monotonic()
            if now - looked >= self._pace.look:
                looked = now
                with contextlib.suppress(zenoh.ZError):  # while the session closes
                    self._look(now)
            self.take()
            turn = self._pace.look
            for neighbour in self.neighbours.values():
                if neighbour.linked:
                    self._send(neighbour)
                    turn = min(turn, self._pace.period, neighbour.next_probe - time.monotonic())
                    if neighbour.meter.loses(now):
                        self._speak(neighbour, now)
                        turn = min(turn, neighbour.next_word - time.monotonic())
            await asyncio.sleep(max(turn, 0.01))

    # The links there are.

    def _look(self, now: float) -> None:
        """Compare with what the session is linked to."""
        linked = {str(t.zid) for t in self._session.info.transports() if str(t.whatami).lower() == "router"}
        links = {str(link.zid): link for link in sorted(self._session.info.links(), key=_reliable)}
        for zid in linked - self.neighbours.keys():
            self.neighbours[zid] = Neighbour(zid, Meter(_source(self.zid)), now)
        for zid, neighbour in list(self.neighbours.items()):
            if neighbour.linked != (zid in linked):
                neighbour.linked, neighbour.since = zid in linked, now
                if neighbour.linked:
                    neighbour.meter.begin(now)
            if link := links.get(zid):
                if neighbour.url != str(link.dst):
                    neighbour.url = str(link.dst)
                    neighbour.interface = interface_to(neighbour.url, link.interfaces)
                if link.auth_identifier and keys.NAME.match(link.auth_identifier):
                    neighbour.name, neighbour.proven = link.auth_identifier, True
            if not neighbour.linked:
                neighbour.close()
                if now - neighbour.since > KEEP:
                    del self.neighbours[zid]

    # What comes.

    def take(self) -> None:
        """Take in what came since the last turn."""
        while self._came:
            now, sample = self._came.popleft()
            try:
                probe = unpack(sample.payload.to_bytes())
                name = keys.match(str(sample.key_expr))[1]["vehicle"]
            except BadInput:
                self.refused += 1
                continue
            neighbour = self._by_source(probe.source)
            if neighbour is None or (neighbour.proven and name != neighbour.name):
                self.refused += 1
                continue
            neighbour.name = name
            neighbour.meter.take(probe, now)

    def _by_source(self, source: bytes) -> Neighbour | None:
        return next((n for zid, n in self.neighbours.items() if _source(zid) == source), None)

    # What goes.

    def _send(self, neighbour: Neighbour) -> None:
        """A probe, where it is due."""
        now = time.monotonic()
        if now < neighbour.next_probe:
            return
        linked = sum(n.linked for n in self.neighbours.values())
        period = self._pace.every(linked, self._budget(neighbour.interface))
        neighbour.next_probe = now + period * random.uniform(0.9, 1.1)  # in step with nobody
        try:
            if neighbour.publisher is None:
                neighbour.publisher = self._session.declare_publisher(
                    keys.PROBE.key(self._fleet, self._name, to=neighbour.zid), **keys.PROBE.publishing()
                )
            neighbour.publisher.put(neighbour.meter.stamp(time.monotonic(), period))
        except zenoh.ZError:
            neighbour.close()  # declared again the next time

    def _speak(self, neighbour: Neighbour, now: float) -> None:
        """A word on the next lane, where it is due."""
        if now < neighbour.next_word or neighbour.publisher is None:
            return
        neighbour.next_word, neighbour.lane = now + self._word_s, (neighbour.lane + 1) % len(LANES)
        with contextlib.suppress(zenoh.ZError):  # while the session closes
            key, drop = neighbour.publisher.key_expr, zenoh.CongestionControl.DROP
            self._session.put(key, b"", priority=LANES[neighbour.lane], congestion_control=drop)


def _reliable(link: zenoh.Link) -> bool:
    """Of a neighbour's two links, that of what must arrive is told of: it comes last here."""
    return str(link.reliability).endswith("RELIABLE")


def _source(zid: str) -> bytes:
    """By which probes tell routers apart: the end of an id, because one that a person gave may be short."""
    return bytes.fromhex(zid.zfill(32))[-SOURCE:]
