"""What was, from memory: of every key the last that came, and as much before it as there is room for."""

from __future__ import annotations

import collections
import threading
import time
from typing import NamedTuple

import msgspec

from ground.record.decoder import Decoder
from ground.record.route import Asked, Route
from zmav import keys, wire

RING = 500
"""entries that are kept of one key"""
ROOM = 128 << 20
"""bytes of payload; when they are full, each key keeps fewer"""
MOST_KEYS = 20_000
COST = 150
"""bytes that an entry takes besides its payload, about"""


class Held(NamedTuple):
    at: int
    data: bytes


class _Ring(NamedTuple):
    route: Route
    entries: collections.deque[Held]
    cut: dict[str, int]
    """``at``: just after the newest entry that was let go"""


class History:
    """Thread-safe. :meth:`add_all` is called by the writer, a batch at a time."""

    def __init__(self, decoder: Decoder, ring: int = RING, room: int = ROOM) -> None:
        self._decoder, self._ring, self._room = decoder, ring, room
        self._rings: dict[str, _Ring] = {}
        self._known: dict[Asked, list[str]] = {}
        self._size = 0
        self._since = time.time_ns()
        self._lock = threading.Lock()

    def add_all(self, batch: list[tuple[Route, int, bytes]]) -> None:
        """``(route, ns UTC, payload)`` in the order in which they came."""
        with self._lock:
            for route, at, data in batch:
                ring = self._rings.get(route.key) or self._new(route)
                if ring is not None:
                    self._add(ring, Held(at, data))

    def _new(self, route: Route) -> _Ring | None:
        if len(self._rings) >= MOST_KEYS:
            return None
        ring = self._rings[route.key] = _Ring(route, collections.deque(), {})
        self._known.setdefault(route.asked, []).append(route.key)
        return ring

    def _add(self, ring: _Ring, held: Held) -> None:
        entries = ring.entries
        entries.append(held)
        self._size += len(held.data) + COST
        while len(entries) > 1 and (len(entries) > self._ring or self._size > self._room):
            gone = entries.popleft()
            self._size -= len(gone.data) + COST
            ring.cut["at"] = gone.at + 1

    def known(self) -> list[Asked]:
        """All that can be asked for."""
        with self._lock:
            return list(self._known)

    def vehicles(self) -> set[tuple[str, str]]:
        """Fleet and name of those that a frame came of."""
        with self._lock:
            return {(r.route.fleet, r.route.vehicle) for r in self._rings.values() if r.route.channel is keys.RX}

    def keys_of(self, asked: Asked) -> list[str]:
        with self._lock:
            return list(self._known.get(asked, ()))

    def newest(self, asked: Asked, since: int, until: int, most: int) -> tuple[list[wire.HistoryEntry], int]:
        """The newest entries between two times (ns UTC), the oldest first, and from when on nothing is missing."""
        found: list[tuple[str, Held]] = []
        with self._lock:
            rings = {key: self._rings[key] for key in self._known.get(asked, ())}
            whole_from = max((ring.cut.get("at", 0) for ring in rings.values()), default=0)
            for key, ring in rings.items():
                fitting = [held for held in ring.entries if since <= held.at <= until]
                found += [(key, held) for held in fitting[-most:]]
        found.sort(key=lambda each: each[1].at)
        entries = [self._entry(key, held, rings[key].route) for key, held in found[-most:]]
        return entries, max(whole_from, self._since)

    def _entry(self, key: str, held: Held, route: Route) -> wire.HistoryEntry:
        """As it is answered: a frame by its fields."""
        return wire.HistoryEntry(key=key, t=held.at / 1e9, value=_readable(self._json(held.data, route)))

    def _json(self, data: bytes, route: Route) -> bytes:
        if not route.frames:
            return data
        with self._lock:  # a decoder is one thread's at a time
            return self._decoder.json(data) or msgspec.json.encode({"frame": data.hex()})


def _readable(data: bytes) -> object:
    """JSON as it is; other bytes in hexadecimal digits."""
    try:
        return msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return {"bytes": data[:1000].hex()}
