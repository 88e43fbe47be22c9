"""What was, from memory: of every key the last that came, and as much before it as there is room for."""

from __future__ import annotations

import collections
import threading
from typing import NamedTuple

import msgspec

from ground.record.decoder import Decoder
from ground.record.route import Asked, Route
from zmav import wire

RING = 200
"""of one key"""
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


class History:
    """Thread-safe. :meth:`add_all` is called by the writer, a batch at a time."""

    def __init__(self, decoder: Decoder, ring: int = RING, room: int = ROOM) -> None:
        self._decoder, self._ring, self._room = decoder, ring, room
        self._rings: dict[str, _Ring] = {}
        self._known: dict[Asked, list[str]] = {}
        self._size = 0
        self._lock = threading.Lock()

    def add_all(self, batch: list[tuple[Route, int, bytes]]) -> None:
        """``(route, ns UTC, payload)`` in the order in which they came."""
        with self._lock:
            for route, at, data in batch:
                ring = self._rings.get(route.key) or self._new(route)
                if ring is not None:
                    self._add(ring.entries, Held(at, data))

    def _new(self, route: Route) -> _Ring | None:
        if len(self._rings) >= MOST_KEYS:
            return None
        ring = self._rings[route.key] = _Ring(route, collections.deque())
        self._known.setdefault(route.asked, []).append(route.key)
        return ring

    def _add(self, entries: collections.deque[Held], held: Held) -> None:
        entries.append(held)
        self._size += len(held.data) + COST
        while len(entries) > self._ring or (self._size > self._room and len(entries) > 1):
            self._size -= len(entries.popleft().data) + COST

    def known(self) -> list[Asked]:
        """All that can be asked for."""
        with self._lock:
            return list(self._known)

    def keys_of(self, asked: Asked) -> list[str]:
        with self._lock:
            return list(self._known.get(asked, ()))

    def last_heard(self) -> dict[tuple[str, str], float]:
        """When something of each vehicle came last, UTC seconds."""
        found: dict[tuple[str, str], float] = {}
        with self._lock:
            for ring in self._rings.values():
                place = (ring.route.fleet, ring.route.vehicle)
                found[place] = max(found.get(place, 0.0), ring.entries[-1].at / 1e9)
        return found

    def newest(self, asked: Asked, since: int, until: int, most: int) -> tuple[list[wire.HistoryEntry], bool]:
        """The newest entries between two times (ns UTC), the oldest of them first, and whether memory reaches back far
        enough for there to be no others.
        """
        found: list[tuple[str, Held]] = []
        reaches = True
        with self._lock:
            for key in self._known.get(asked, ()):
                ring = self._rings[key]
                fitting = [held for held in ring.entries if since <= held.at <= until]
                found += [(key, held) for held in fitting[-most:]]
                cut = len(ring.entries) >= self._ring or self._size > self._room
                reaches = reaches and not (cut and ring.entries[0].at > since)
        found.sort(key=lambda each: each[1].at)
        enough = len(found) >= most
        entries = [self.entry(key, held, self._rings[key].route) for key, held in found[-most:]]
        return entries, reaches or enough

    def entry(self, key: str, held: Held, route: Route) -> wire.HistoryEntry:
        """As it is answered: a frame by its fields."""
        data = held.data
        if route.frames:
            data = self._decoder_of(data)
        return wire.HistoryEntry(key=key, t=held.at / 1e9, value=readable(data))

    def _decoder_of(self, frame: bytes) -> bytes:
        with self._lock:  # a decoder is one thread's at a time
            return self._decoder.json(frame) or msgspec.json.encode({"frame": frame.hex()})


def readable(data: bytes) -> object:
    """JSON as it is; other bytes in hexadecimal digits."""
    try:
        return msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return {"bytes": data[:1000].hex()}
