"""Probing each router that ours is linked to: over that link, and no other.

A router listens on ``@probe/{its own id}/*``, a key that nobody else answers, and Zenoh sends what is for a neighbour
straight to it: who gives links weights of his own (``transport_weights``) so that a way around is the shorter one
measures that way. A neighbour's name comes with the certificate by which its link was opened, or else with the key of
what it sends.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh
from zenoh import handlers

from mesh.quality.interface import interface_to
from mesh.quality.meter import Meter
from mesh.quality.pace import Pace
from mesh.quality.stamp import SOURCE, unpack
from zmav import keys
from zmav.errors import BadInput

LOOK = 0.5
"""s between looks at the router's links"""
KEEP = 60.0
"""s for which a neighbour that went away is still told of"""
MOST_WAITING = 4096
"""probes that wait for the next turn; of a flood the oldest go"""
FIRST_TRAIN, FIRST_TRAINS = 2.0, 3
"""s from a link's coming up to the first train, and between so many first ones"""


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
    trains: int = 0
    next_stamp: float = 0.0
    next_train: float = 0.0
    publishers: dict[keys.Qos, zenoh.Publisher] = field(default_factory=dict)

    def close(self) -> None:
        for publisher in self.publishers.values():
            with contextlib.suppress(zenoh.ZError):  # the session may be closed
                publisher.undeclare()
        self.publishers.clear()


class Prober:
    """Measures the neighbours of one router's session. On the event loop; ``start`` it and ``close`` it."""

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        name: str,
        pace: Pace | None = None,
        budget: Callable[[str | None], float | None] = lambda interface: None,
    ) -> None:
        self._session, self._fleet, self._name = session, fleet, name
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
            self._came.append((time.monotonic(), sample))

        # Straight on Zenoh's thread, so that the time is that of the arrival.
        key = keys.PROBE.key(self._fleet, "*", to=self.zid)
        self._subscriber = self._session.declare_subscriber(key, handlers.Callback(on_sample, indirect=False))
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        with contextlib.suppress(zenoh.ZError):
            self._subscriber.undeclare()
        for neighbour in self.neighbours.values():
            neighbour.close()

    async def _run(self) -> None:
        looked = float("-inf")
        while True:
            now = time.monotonic()
            if now - looked >= LOOK:
                looked = now
                with contextlib.suppress(zenoh.ZError):  # while the session closes
                    self._look(now)
            self.take()
            turn = self._pace.period
            for neighbour in self.neighbours.values():
                if neighbour.linked:
                    self._send(neighbour)
                    turn = min(turn, neighbour.next_stamp - time.monotonic())
            await asyncio.sleep(max(turn, 0.01))

    # The links there are.

    def _look(self, now: float) -> None:
        """Compare with what the session is linked to."""
        linked = {str(t.zid) for t in self._session.info.transports() if str(t.whatami).lower() == "router"}
        links = {str(link.zid): link for link in sorted(self._session.info.links(), key=_reliable)}
        for zid in linked - self.neighbours.keys():
            self.neighbours[zid] = Neighbour(zid, Meter(_source(self.zid)), now)
            self.neighbours[zid].next_train = now + FIRST_TRAIN * random.uniform(1.0, 1.4)
        for zid, neighbour in list(self.neighbours.items()):
            if neighbour.linked != (zid in linked):
                neighbour.linked, neighbour.since = zid in linked, now
                if neighbour.linked:
                    neighbour.meter.begin(now)
                    neighbour.trains, neighbour.next_train = 0, now + FIRST_TRAIN * random.uniform(1.0, 1.4)
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
        """A stamp, and a train, where they are due."""
        now, linked = time.monotonic(), sum(n.linked for n in self.neighbours.values())
        budget = self._budget(neighbour.interface)
        if now >= neighbour.next_stamp:
            period = self._pace.stamps(linked, budget)
            neighbour.next_stamp = now + period * random.uniform(0.9, 1.1)  # in step with nobody
            self._put(neighbour, keys.Qos.LATEST_WINS, [neighbour.meter.stamp(time.monotonic(), period)])
        if now >= neighbour.next_train:
            count, every = self._pace.trains(linked, budget, neighbour.meter.figures(now).throughput_out)
            neighbour.trains += 1
            soon = FIRST_TRAIN if neighbour.trains < FIRST_TRAINS else every
            neighbour.next_train = now + soon * random.uniform(1.0, 1.4)
            self._put(neighbour, keys.Qos.BULK, neighbour.meter.train(count))

    def _put(self, neighbour: Neighbour, qos: keys.Qos, messages: list[bytes]) -> None:
        try:
            if qos not in neighbour.publishers:
                neighbour.publishers[qos] = self._session.declare_publisher(
                    keys.PROBE.key(self._fleet, self._name, to=neighbour.zid),
                    encoding=keys.PROBE.encoding,
                    reliability=zenoh.Reliability.BEST_EFFORT,
                    **qos.options(),
                )
            for message in messages:
                neighbour.publishers[qos].put(message)
        except zenoh.ZError:
            neighbour.close()  # declared again the next time


def _reliable(link: zenoh.Link) -> bool:
    """Of a neighbour's two links, that of what must arrive is told of: it comes last here."""
    return str(link.reliability).endswith("RELIABLE")


def _source(zid: str) -> bytes:
    """By which probes tell routers apart: the end of an id, because one that a person gave may be short."""
    return bytes.fromhex(zid.zfill(32))[-SOURCE:]
