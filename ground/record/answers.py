"""Answers questions of what was, from memory."""

from __future__ import annotations

import contextlib
import math

import msgspec
import zenoh

from ground.record.history import RING, History
from ground.record.route import Asked
from zmav import keys, wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.wire.history import MOST

MOST_ENTRIES = 25_000
"""entries that may be told for one question: each is decoded on the thread on which samples come"""
ROOM = 48 << 10
"""bytes of one answer: of what takes more than one of Zenoh's batches (64 kB), a part and so the whole can be lost"""
END = (1 << 63) - 1


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
