"""``param`` and ``param/{NAME}``: queries answered from the cache."""

from __future__ import annotations

import asyncio
import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, ZmavError
from zmav.services.port import on_loop
from zmav.services.proven import Answers

if TYPE_CHECKING:
    from zmav.services.param import Params


def unknown(name: str, names: Iterable[str]) -> BadInput:
    """The error for a name that no parameter has."""
    close = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.6)
    expected = f"a name such as {', '.join(close)}" if close else "a parameter's name"
    hint = f"; did you mean {', '.join(close)}?" if close else ""
    return BadInput(f"no parameter {name!r}{hint}", field="name", value=name, expected=expected)


class ParamQueries:
    """Lives on the event loop."""

    def __init__(self, session: zenoh.Session, params: Params, answers: Answers) -> None:
        self._session, self._params, self._answering = session, params, answers
        self._queryables: list[Any] = []
        self._answers: set[asyncio.Task[None]] = set()
        self._encoded: tuple[tuple[object, ...], wire.ParamTable, bytes] | None = None
        self._closed = False

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._queryables = [
            self._session.declare_queryable(self._table_key(), on_loop(loop, self._on_table)),
            self._session.declare_queryable(self._key("*"), on_loop(loop, self._on_name)),
        ]

    def close(self) -> None:
        self._closed = True
        for queryable in self._queryables:
            queryable.undeclare()
        for answer in self._answers:
            answer.cancel()

    def _table_key(self) -> str:
        return keys.PARAMS.key(self._params.fleet, self._params.vehicle)

    def _key(self, name: str) -> str:
        return keys.PARAM.key(self._params.fleet, self._params.vehicle, param=name)

    def _on_table(self, query: zenoh.Query) -> None:
        with query:
            try:
                asked = wire.decode(query.payload.to_bytes() if query.payload else b"", wire.ParamQuery, "param")
            except BadInput as e:
                self._answering.refuse(query, e)
                return
            self._answering.give(query, self._table_key(), self._table(asked.hash))

    def _table(self, has: str) -> bytes:
        """The set, or a line where the asker has it already."""
        params = self._params
        state = (params.known.version, params.known.complete, params.talk.encoding)
        if self._encoded is None or self._encoded[0] != state:
            table = params.table()
            self._encoded = (state, table, wire.encode(table))
        _, table, encoded = self._encoded
        if table.hash != has:
            return encoded
        short = wire.ParamTable(
            t=params.known.confirmed, complete=table.complete, count=table.count, hash=table.hash,
            autopilot=table.autopilot, firmware=table.firmware, encoding=table.encoding, unchanged=True,
        )  # fmt: skip
        return wire.encode(short)

    def _on_name(self, query: zenoh.Query) -> None:
        asked = str(query.key_expr)
        if self._closed or asked.endswith("**"):
            query.drop()  # who looks around for everything gets the table, and not every line of it once more
        elif "*" in asked:
            with query:
                self._reply_all(query, asked.rpartition("/")[2])
        else:
            answer = asyncio.get_running_loop().create_task(self._answer(query, asked.rpartition("/")[2]))
            self._answers.add(answer)
            answer.add_done_callback(self._answers.discard)

    def _reply_all(self, query: zenoh.Query, last: str) -> None:
        """Each that matches, under its own key; nothing where none does."""
        names = [last] if "*" not in last else sorted(self._params.known.entries)
        for name in names:
            param = self._params.get(name)
            if param is not None and query.key_expr.intersects(self._key(name)):
                query.reply(self._key(name), wire.encode(param), encoding=keys.JSON)

    async def _answer(self, query: zenoh.Query, name: str) -> None:
        with query:
            try:
                param = self._params.get(name)
                if param is None and self._params.known.complete:
                    raise unknown(name, self._params.known.entries)
                param = param or await self._params.find(name)
            except ZmavError as e:
                self._answering.refuse(query, e)
            else:
                self._answering.give(query, self._key(name), wire.encode(param))
