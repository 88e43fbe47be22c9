"""The newest value of everything that is to be painted, and for each painter what of it has changed since it asked.

table = Table()
screen = table.reader()
table.put("state", ("demo", "quad1"), payload)
batch = screen.take()

Nothing here waits: a painter that does not come back for its next batch finds fewer, newer values when it does, and the
memory is bounded by the number of things, not by the time.
"""

from __future__ import annotations

import collections
import threading
import time
from typing import NamedTuple

import msgspec

MOST = 20_000
"""things remembered; more than that are somebody's invention"""
LINES = 500
"""events that wait for a painter; of more, the oldest are left out and counted"""
LARGEST = 4_000_000
"""bytes of a value: a larger one is not painted"""
PORTION = 16_000_000
"""bytes in a batch, about: a painter fetches the rest with the next one"""


class Item(NamedTuple):
    """One value: what it is, whose, and when it came."""

    kind: str
    """the name of the channel it came on (``state``), or ``graph``, ``plan``, ``home``"""
    place: tuple[str, ...]
    """fleet, vehicle, and what else its key says"""
    t: float
    """UTC seconds when it came here"""
    mono: float
    """by this computer's monotonic clock"""
    payload: bytes


class Batch(msgspec.Struct, array_like=True):
    """What goes to a painter at once."""

    items: list[Item]
    lost: int = 0
    """events left out since the last batch"""


class Reader:
    """What one painter has not had yet."""

    def __init__(self, lock: threading.Lock, now: dict[tuple[str, ...], Item], portion: int) -> None:
        self._lock, self._portion = lock, portion
        self._changed = dict(now)
        self._lines: collections.deque[Item] = collections.deque(maxlen=LINES)
        self._lost = 0

    def __len__(self) -> int:
        return len(self._changed) + len(self._lines)

    def take(self) -> Batch:
        """Everything that has changed since the last call, events in their order; what is too much comes next time."""
        with self._lock:
            items, size = [], 0
            for items_key in list(self._changed):
                item = self._changed.pop(items_key)
                items.append(item)
                size += len(item.payload)
                if size > self._portion:
                    break
            items += self._lines
            batch = Batch(items, self._lost)
            self._lines.clear()
            self._lost = 0
            return batch

    def _put(self, key: tuple[str, ...], item: Item) -> None:
        self._changed[key] = item

    def _append(self, item: Item) -> None:
        if len(self._lines) == self._lines.maxlen:
            self._lost += 1
        self._lines.append(item)


class Table:
    """Written by one thread or many, read by painters; every call returns at once."""

    def __init__(self, most: int = MOST, portion: int = PORTION) -> None:
        self._most, self._portion = most, portion
        self._lock = threading.Lock()
        self._now: dict[tuple[str, ...], Item] = {}
        self._readers: list[Reader] = []
        self.refused = 0
        """values left out for their size or their number"""

    def reader(self) -> Reader:
        """A painter's own view, which begins with all that is known."""
        with self._lock:
            reader = Reader(self._lock, self._now, self._portion)
            self._readers.append(reader)
            return reader

    def drop(self, reader: Reader) -> None:
        with self._lock:
            self._readers.remove(reader)

    def put(self, kind: str, place: tuple[str, ...], payload: bytes) -> None:
        """Overwrite the value of that kind and place."""
        key = (kind, *place)
        with self._lock:
            if len(payload) > LARGEST or (key not in self._now and len(self._now) >= self._most):
                self.refused += 1
                return
            self._now[key] = item = Item(kind, place, time.time(), time.monotonic(), payload)
            for reader in self._readers:
                reader._put(key, item)

    def append(self, kind: str, place: tuple[str, ...], payload: bytes) -> None:
        """An event: it does not replace the one before it."""
        item = Item(kind, place, time.time(), time.monotonic(), payload)
        with self._lock:
            if len(payload) > LARGEST:
                self.refused += 1
                return
            for reader in self._readers:
                reader._append(item)
