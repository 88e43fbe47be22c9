"""What was, from the files: those of this session and of earlier ones in the same folder."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ground.record.folder import Folder
from ground.record.history import readable
from ground.record.route import Asked, asked_of
from ground.record.storage import Storage
from zmav import wire
from zmav.errors import BadKey

if TYPE_CHECKING:
    from ground.record.mcapfile import Read

MOST_ASKED = 20_000
"""things of which it is known in which topics they are"""


class _Span(NamedTuple):
    """Of a finished file: ns UTC."""

    first: int
    last: int


class Files:
    """Searched by one thread; what is known may be asked by any."""

    def __init__(self, storage: Storage, folder: Folder) -> None:
        self._storage, self._folder = storage, folder
        self._spans: dict[Path, _Span] = {}
        self._topics: dict[Asked, set[str]] = {}
        self._lock = threading.Lock()

    def known(self) -> list[Asked]:
        """All that the finished files can tell of, as far as they were looked at."""
        with self._lock:
            return list(self._topics)

    def look(self, over: Callable[[], bool]) -> None:
        """Look at files that are new, until it is ``over``, and forget those that somebody took away."""
        if not self._storage.kinds.mcap:
            return
        from ground.record import mcapfile

        there = self._folder.recordings()
        for gone in self._spans.keys() - set(there):
            del self._spans[gone]
        for path in there:
            if over():
                return
            if path not in self._spans and (found := mcapfile.contents(path)) is not None:
                self._spans[path] = _Span(found.first, found.last)
                self._learn(found.topics)

    def _learn(self, topics: Collection[str]) -> None:
        with self._lock:
            for topic in topics:
                with contextlib.suppress(BadKey):
                    asked = asked_of(topic)
                    if asked in self._topics or len(self._topics) < MOST_ASKED:
                        self._topics.setdefault(asked, set()).add(topic)

    def search(self, asked: Asked, since: int, until: int, over: Callable[[], bool]) -> Iterator[wire.HistoryEntry]:
        """What was recorded between two times (ns UTC), the newest first, until it is ``over``. Raises what reading
        damaged files does.
        """
        self.look(over)
        topics = {*self._topics.get(asked, ()), *self._storage.history.keys_of(asked)}
        for source in self._sources(since, until):
            if over():
                return
            with contextlib.suppress(OSError):  # a file that was just taken away
                for found in source(topics, since, until):
                    yield wire.HistoryEntry(key=found.topic, t=found.at / 1e9, value=readable(found.data))

    def _sources(self, since: int, until: int) -> Iterator[Callable[[Collection[str], int, int], Iterator[Read]]]:
        """The file that is being written, then the finished ones, the newest first."""
        if not self._storage.kinds.mcap:
            return
        from ground.record import mcapfile

        part = self._storage.part
        if part is not None and part.mcap is not None:
            yield part.mcap.read
        for path, span in sorted(self._spans.items(), key=lambda each: each[1].first, reverse=True):
            if span.first <= until and span.last >= since:
                yield functools.partial(mcapfile.read_back, path)
