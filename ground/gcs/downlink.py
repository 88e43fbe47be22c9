"""From the vehicles to the clients: the hot path. A frame goes from Zenoh's thread straight to the sockets."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence

import msgspec

from ground.feed import Origin
from ground.gcs.answerer import Answerer
from ground.gcs.client import Client
from ground.gcs.kinds import MOST_KINDS, Kind, Track
from ground.gcs.routes import Routes
from zmav.mavlink import Dialect

logger = logging.getLogger(__name__)
LATELY = 10.0
"""s for which an answer is taken to be for anyone who spoke to the vehicle"""


class Counters(msgspec.Struct):
    """Frames of vehicles."""

    torn: int = 0
    """no whole frame of the component that its key names"""
    withheld: int = 0
    """of no concern to clients"""


class Routed(Kind):
    """``getters`` are the clients that get it; good for as long as ``version`` is the bridge's."""

    __slots__ = ("getters", "version")

    def __init__(self, origin: Origin, dialect: Dialect, track: Track, watched: frozenset[str]) -> None:
        super().__init__(origin, dialect, track, watched)
        self.version = -1
        self.getters: tuple[Client, ...] = ()


class Downlink:
    """:meth:`on_frame` is the feed's; the rest may be called from any thread."""

    def __init__(self, dialect: Dialect, routes: Routes, answerers: Sequence[Answerer]) -> None:
        self._dialect, self._routes = dialect, routes
        self.counters = Counters()
        self._answerers = answerers
        self._watched = frozenset(name for answerer in answerers for name in answerer.watches)
        self._clients: tuple[Client, ...] = ()
        self._kinds: dict[str, Routed] = {}
        self._version = 0
        self._lock = threading.Lock()
        self._failed: set[str] = set()

    @property
    def clients(self) -> tuple[Client, ...]:
        return self._clients

    def add(self, client: Client) -> None:
        with self._lock:
            self._clients = (*self._clients, client)
        self.changed()

    def remove(self, client: Client) -> None:
        with self._lock:
            self._clients = tuple(each for each in self._clients if each is not client)
        self.changed()

    def changed(self) -> None:
        """Who gets what is to be worked out again: a client came, went or took another id."""
        with self._lock:
            self._version += 1

    def on_frame(self, origin: Origin, data: bytes) -> None:
        kind = self._kinds.get(origin.key) or self._new_kind(origin)
        counters = self.counters
        if not kind.is_whole(data):
            counters.torn += 1
            return
        kind.track.heard = time.monotonic()
        if kind.version != self._version:
            self._aim(kind)
        getters = kind.getters
        other = self._routes.other_way(kind.track.place, origin.sysid, origin.compid)
        if other is not None:  # by which it comes, too, to all but those who do not see that one
            getters = tuple(client for client in getters if not client.options.sees(other[1]))
            if not getters:
                return
        if kind.watched and self._is_withheld(origin, data):
            counters.withheld += 1
            for client in getters:
                client.leave_out(kind, data)
            return
        if kind.target_at is not None and (target := kind.target(data)):
            self._deliver_to(target, getters, kind, data)
            return
        for client in getters:
            client.deliver(kind, data)

    def _new_kind(self, origin: Origin) -> Routed:
        track = self._routes.track((origin.fleet, origin.vehicle), origin.sysid)
        kind = Routed(origin, self._dialect, track, self._watched)
        if len(self._kinds) < MOST_KINDS:
            self._kinds[origin.key] = kind
        return kind

    def _aim(self, kind: Routed) -> None:
        """Work out who gets it: all who see the vehicle, but nobody what he says himself."""
        kind.version = self._version
        origin = kind.origin
        seeing = (c for c in self._clients if c.options.sees(origin.vehicle) and origin.sysid not in c.systems)
        kind.getters = tuple(seeing)

    def _deliver_to(self, target: int, getters: Sequence[Client], kind: Routed, data: bytes) -> None:
        """What is said to somebody: to the clients that are meant, and among several of one id to who has just spoken
        to that vehicle. A read-only one has said nothing to it: what comes here is for its namesake elsewhere."""
        meant = [client for client in getters if target in client.systems and not client.read_only]
        if len(meant) > 1:
            since, place = time.monotonic() - LATELY, kind.track.place
            lately = [client for client in meant if client.addressed.get(place, 0.0) > since]
            meant = lately or meant
        for client in getters:
            if client in meant:
                client.deliver(kind, data)
            else:
                client.leave_out(kind, data)

    def _is_withheld(self, origin: Origin, data: bytes) -> bool:
        for answerer in self._answerers:
            try:
                if origin.message in answerer.watches and answerer.withhold(origin, data):
                    return True
            except Exception:
                name = type(answerer).__name__
                if name not in self._failed:
                    self._failed.add(name)
                    logger.exception("%s failed; said once", name)
        return False
