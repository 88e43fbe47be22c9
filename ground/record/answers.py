"""Answers questions of what was: from memory, and where that does not reach back far enough from the files."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import msgspec
import zenoh

from ground.record.files import Files
from ground.record.folder import Folder
from ground.record.history import RING
from ground.record.route import Asked
from ground.record.storage import Storage
from zmav import keys, wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.wire.history import MOST

logger = logging.getLogger(__name__)
WAITING = 8
"""questions that may wait for the files"""
MOST_LATE = 50
"""things that are looked for in the files for one question"""
MOST_ENTRIES = 10_000
"""entries that may be told for one question: each is decoded on the thread on which samples come"""
SEARCH_S = 10.0
"""for one question to the files; then what was found is told, and that there may be more"""
ROOM = 48 << 10
"""bytes of one answer: of what takes more than one of Zenoh's batches (64 kB), a part and so the whole can be lost"""
END = (1 << 63) - 1


class Answers:
    """A queryable on ``history/{of}/{what}`` under the recorder's own name, in every fleet that it records."""

    def __init__(self, session: zenoh.Session, storage: Storage, folder: Folder, fleet: str, name: str) -> None:
        self._storage, self._name = storage, name
        self._files = Files(storage, folder)
        self._searcher = ThreadPoolExecutor(1, "record-search")
        self._waiting = threading.BoundedSemaphore(WAITING)
        self._closing = threading.Event()
        self._searcher.submit(self._files.look, self._closing.is_set)
        self._queryable = session.declare_queryable(keys.HISTORY.key(fleet, name, of="*", what="*"), self._on_query)

    def close(self) -> None:
        self._queryable.undeclare()
        self._closing.set()
        self._searcher.shutdown(cancel_futures=True)

    def _on_query(self, query: zenoh.Query) -> None:
        """On a thread of Zenoh's: what memory can tell is told at once."""
        try:
            wanted = _read_query(query)
        except ZmavError as e:
            _refuse(query, e)
            return
        found = self._asked(query)
        if len(found) * min(wanted.most, RING) > MOST_ENTRIES:
            text = f"{len(found)} things with up to {wanted.most} entries each are too much at a time: ask for fewer"
            _refuse(query, Refused(text, reason="wide"))
            return
        late = [asked for asked in found if not self._from_memory(query, asked, wanted)]
        if not late:
            query.drop()
            return
        if len(late) > MOST_LATE:
            text = f"{len(late)} things would have to be looked for in the files: ask for {MOST_LATE} at most at a time"
            _refuse(query, Refused(text, reason="wide"))
            return
        if not self._waiting.acquire(blocking=False):
            _refuse(query, Refused(f"{WAITING} questions wait for the files already: ask again", reason="busy"))
            return
        self._searcher.submit(self._from_files, query, late, wanted)

    def _asked(self, query: zenoh.Query) -> list[Asked]:
        expression = query.key_expr
        known = dict.fromkeys((*self._storage.history.known(), *self._files.known()))
        return [asked for asked in known if expression.intersects(self._key(asked))]

    def _key(self, asked: Asked) -> zenoh.KeyExpr:
        return zenoh.KeyExpr(keys.HISTORY.key(asked.fleet, self._name, of=asked.of, what=asked.what))

    def _from_memory(self, query: zenoh.Query, asked: Asked, wanted: _Wanted) -> bool:
        """False, with nothing said, where the files must be asked."""
        entries, whole_from = self._storage.history.newest(asked, wanted.since, wanted.until, wanted.most + 1)
        if len(entries) < wanted.most and whole_from > wanted.since:
            return False
        self._reply(query, asked, entries, wanted.most, more=wanted.since < whole_from)
        return True

    def _from_files(self, query: zenoh.Query, late: list[Asked], wanted: _Wanted) -> None:
        """On the thread of searches."""
        deadline = time.monotonic() + SEARCH_S

        def over() -> bool:
            return self._closing.is_set() or time.monotonic() > deadline

        try:
            for asked in late:
                entries, whole_from = self._storage.history.newest(asked, wanted.since, wanted.until, wanted.most + 1)
                until, missing = min(wanted.until, whole_from - 1), wanted.most + 1 - len(entries)
                older = list(itertools.islice(self._files.search(asked, wanted.since, until, over), missing))
                self._reply(query, asked, [*reversed(older), *entries], wanted.most, more=over())
        except Exception as e:  # a file that somebody else damaged: the next question is answered nevertheless
            logger.warning("a question of what was could not be answered from the files: %r", e)
            _refuse(query, Refused(f"the recordings could not be read: {e}", reason="files"))
        finally:
            self._waiting.release()
            query.drop()

    def _reply(
        self, query: zenoh.Query, asked: Asked, entries: list[wire.HistoryEntry], most: int, more: bool = False
    ) -> None:
        more = more or len(entries) > most
        kept: list[wire.HistoryEntry] = []
        size = 0
        for entry in reversed(entries[-most:]):
            size += len(msgspec.json.encode(entry))
            if kept and size > ROOM:
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
    """JSON in the payload, or ``?since=..&until=..&last=N`` behind the key. Raises :class:`BadInput`."""
    payload = query.payload
    if payload is not None and len(payload):
        asked = wire.decode(payload.to_bytes(), wire.HistoryQuery, "history")
    else:
        found = {name: query.parameters.get(name) for name in wire.HistoryQuery.__struct_fields__}
        given = {name: _number(name, text) for name, text in found.items() if text is not None}
        asked = wire.decode(msgspec.json.encode(given), wire.HistoryQuery, "history")
    if asked.since is not None and asked.until is not None and asked.since > asked.until:
        text = f"history: since {asked.since} is after until {asked.until}"
        raise BadInput(text, field="since", value=asked.since, expected="a time before until")
    ranged = asked.since is not None or asked.until is not None
    return _Wanted(since=_ns(asked.since, 0), until=_ns(asked.until, END), most=asked.last or (MOST if ranged else 1))


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BadInput(f"history: {name} is {text!r}; expected a number", field=name, value=text, expected="a number")
    return int(number) if number.is_integer() else number


def _ns(seconds: float | None, default: int) -> int:
    if seconds is None:
        return default
    return int(min(max(seconds * 1e9, 0), END))


def _refuse(query: zenoh.Query, error: ZmavError) -> None:
    with contextlib.suppress(zenoh.ZError):
        query.reply_err(wire.error_body(error), encoding=keys.JSON)
    query.drop()
