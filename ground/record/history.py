"""What was, from memory: of every key the last that came, and as much before it as there is room for; and answers to
questions of it.
"""

from __future__ import annotations

import collections
import contextlib
import threading
import time
from typing import NamedTuple

import msgspec
import zenoh

from ground.record.decoder import Decoder
from ground.record.part import Asked, Route
from zmav import keys, wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.services.queries.questions import refuse_parameters
from zmav.wire.history import MOST

RING = 500
"""entries that are kept of one key"""
ROOM = 128 << 20
"""bytes of payload; when they are full, each key keeps fewer, and none only where others' last alone fill them"""
MOST_KEYS = 20_000
COST = 150
"""bytes that an entry takes besides its payload, about"""
MOST_ENTRIES = 25_000
"""entries that may be told for one question: each is decoded on the thread on which samples come"""
LONGEST_ANSWER = 48 << 10
"""bytes of one answer: of what takes more than one of Zenoh's batches (64 kB), a part and so the whole can be lost"""
END = (1 << 63) - 1


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

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._rings: dict[str, _Ring] = {}
        self._known: dict[Asked, list[str]] = {}
        self._several: collections.OrderedDict[str, _Ring] = collections.OrderedDict()
        """those of more than one entry, in turn"""
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
        if len(entries) > 1:
            self._several.setdefault(ring.route.key, ring)
        while len(entries) > RING or self._size > ROOM:
            self._let_go(ring if len(entries) > RING else self._fuller(ring))

    def _fuller(self, ring: _Ring) -> _Ring:
        """It, or the next in turn where that has more: so all come to have about as many, and each its last."""
        other = next(iter(self._several.values()), ring)
        if self._several:
            self._several.move_to_end(other.route.key)
        return other if len(other.entries) > len(ring.entries) else ring

    def _let_go(self, ring: _Ring) -> None:
        gone = ring.entries.popleft()
        self._size -= len(gone.data) + COST
        ring.cut["at"] = gone.at + 1
        if len(ring.entries) == 1:
            del self._several[ring.route.key]

    def known(self) -> list[Asked]:
        """All that can be asked for."""
        with self._lock:
            return list(self._known)

    def vehicles(self) -> set[tuple[str, str]]:
        """Fleet and name of those that a frame came of."""
        with self._lock:
            return {(r.route.fleet, r.route.vehicle) for r in self._rings.values() if r.route.channel is keys.RX}

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


class Answers:
    """A queryable on ``history/{of}/{what}`` under the recorder's own name, in every fleet that it records."""

    def __init__(self, session: zenoh.Session, history: History, fleet: str, name: str) -> None:
        self._history, self._name = history, name
        self._queryable = session.declare_queryable(keys.HISTORY.key(fleet, name, of="*", what="*"), self._on_query)

    def close(self) -> None:
        self._queryable.undeclare()

    def _on_query(self, query: zenoh.Query) -> None:
        """On a thread of Zenoh's."""
        try:
            refuse_parameters(query)
            wanted = _read_query(query)
            found = [asked for asked in self._history.known() if query.key_expr.intersects(self._key(asked))]
            if len(found) * min(wanted.most, RING) > MOST_ENTRIES:
                text = f"{len(found)} things with up to {wanted.most} entries each are too much at a time"
                raise Refused(f"{text}: ask for fewer", reason="wide")
        except ZmavError as e:
            with contextlib.suppress(zenoh.ZError):
                query.reply_err(wire.error_body(e), encoding=keys.JSON)
        else:
            for asked in found:
                self._reply(query, asked, wanted)
        query.drop()

    def _key(self, asked: Asked) -> zenoh.KeyExpr:
        return zenoh.KeyExpr(keys.HISTORY.key(asked.fleet, self._name, of=asked.of, what=asked.what))

    def _reply(self, query: zenoh.Query, asked: Asked, wanted: _Wanted) -> None:
        most = wanted.most
        entries, whole_from = self._history.newest(asked, wanted.since, wanted.until, most + 1)
        more = len(entries) > most or wanted.since < whole_from
        kept: list[wire.HistoryEntry] = []
        size = 0
        for entry in reversed(entries[-most:]):
            size += len(msgspec.json.encode(entry))
            if kept and size > LONGEST_ANSWER:
                more = True
                break
            kept.append(entry)
        answer = wire.History(recorder=self._name, of=asked.of, what=asked.what, entries=kept[::-1], more=more)
        with contextlib.suppress(zenoh.ZError):  # anyone who asked is gone
            query.reply(self._key(asked), wire.encode(answer), encoding=keys.HISTORY.encoding)


class _Wanted(msgspec.Struct, frozen=True):
    """Times in ns UTC."""

    since: int
    until: int
    most: int


def _read_query(query: zenoh.Query) -> _Wanted:
    """JSON in the payload; without one, the last entry. Raises :class:`BadInput`."""
    asked = wire.decode(query.payload.to_bytes() if query.payload else b"{}", wire.HistoryQuery, "history")
    if asked.since is not None and asked.until is not None and asked.since > asked.until:
        text = f"history: since {asked.since} is after until {asked.until}"
        raise BadInput(text, field="since", value=asked.since, expected="a time before until")
    ranged = asked.since is not None or asked.until is not None
    return _Wanted(since=_ns(asked.since, 0), until=_ns(asked.until, END), most=asked.last or (MOST if ranged else 1))


def _ns(seconds: float | None, default: int) -> int:
    if seconds is None:
        return default
    return int(min(max(seconds * 1e9, 0), END))
