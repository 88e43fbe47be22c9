"""``param`` and ``param/{NAME}``: answered from the cache, in the lane of questions."""

from __future__ import annotations

import asyncio
import difflib
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

import msgspec
import zenoh

from zmav import keys, wire
from zmav.errors import BadInput
from zmav.services.companion import Companion
from zmav.services.params.requests import ParamTalk
from zmav.services.params.values import ParamSet
from zmav.services.queries.questions import Reply
from zmav.trust.verify import Allowance

HINTS = 2.0
"""a second: names like one that there is not take milliseconds to find"""
LONGEST_NAME = 16


def unknown(name: str, names: Iterable[str]) -> BadInput:
    """The error for a name that no parameter has, with those like it; none for what is too long to be one."""
    close = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.6) if len(name) <= LONGEST_NAME else []
    expected = f"a name such as {', '.join(close)}" if close else "a parameter's name"
    hint = f"; did you mean {', '.join(close)}?" if close else ""
    return BadInput(f"no parameter {name!r}{hint}", field="name", value=name, expected=expected)


class ParamQueries:
    """Answers in the lane of questions, from what is ``known``; what is not is looked for by ``find``, on the loop.

    ``table()`` is the whole set.
    """

    def __init__(
        self,
        companion: Companion,
        known: ParamSet,
        talk: ParamTalk,
        table: Callable[[], wire.ParamTable],
        find: Callable[[str], Coroutine[Any, Any, wire.Param]],
    ) -> None:
        self._questions, self._port, self._known, self._talk = companion.questions, companion.port, known, talk
        self._whole, self._find = table, find
        self._hints = Allowance(HINTS, time.monotonic)
        self._encoded: tuple[tuple[object, ...], wire.ParamTable, bytes] | None = None

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._questions.declare(self._table_key(), self._on_table)
        self._questions.declare(self._key("*"), lambda query: self._on_name(query, loop))

    def _table_key(self) -> str:
        return keys.PARAMS.key(self._port.fleet, self._port.name)

    def _key(self, name: str) -> str:
        return keys.PARAM.key(self._port.fleet, self._port.name, param=name)

    def _on_table(self, query: zenoh.Query) -> Iterator[Reply]:
        asked = wire.decode(query.payload.to_bytes() if query.payload else b"", wire.ParamQuery, "param")
        yield Reply(self._table_key(), self._table(asked.hash))

    def _table(self, has: str) -> bytes:
        """The set, or a line where the asker has it already."""
        version = self._known.version, self._known.complete, self._talk.encoding
        if self._encoded is None or self._encoded[0] != version:
            table = self._whole()
            self._encoded = (version, table, wire.encode(table))
        _, table, encoded = self._encoded
        if table.hash != has:
            return encoded
        return wire.encode(msgspec.structs.replace(table, t=self._known.confirmed, params=[], unchanged=True))

    def _on_name(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Iterator[Reply | Future[Any]]:
        asked = str(query.key_expr)
        if asked.endswith("**"):
            return  # who looks around for everything gets the table, and not every line of it once more
        last = asked.rpartition("/")[2]
        if "*" in asked:
            yield from self._all(query, [last] if "*" not in last else self._known.names())
            return
        found = self._line(last)
        if found is None and self._known.complete:
            hints = len(last) <= LONGEST_NAME and self._hints.take()
            raise unknown(last, self._known.names() if hints else ())
        if found is None:
            yield (heard := asyncio.run_coroutine_threadsafe(self._find(last), loop))
            found = wire.encode(heard.result())
        yield Reply(self._key(last), found)

    def _all(self, query: zenoh.Query, names: list[str]) -> Iterator[Reply]:
        """Each that matches, under its own key; nothing where none does."""
        for name in names:
            line = self._line(name)
            if line is not None and query.key_expr.intersects(self._key(name)):
                yield Reply(self._key(name), line)

    def _line(self, name: str) -> bytes | None:
        """One parameter from the cache."""
        try:
            return wire.encode(self._known.param(self._known.spelt(name), self._talk.encoding))
        except KeyError:
            return None
