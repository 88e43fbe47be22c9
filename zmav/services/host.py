"""``host``: how the computer is on which this runs, for ``zmav doctor``. Nothing is looked at until somebody asks."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import zenoh

from zmav import keys, wire
from zmav.host import report


class HostService:
    """Answers in Zenoh's own threads; ``paths`` are on the file systems that matter here."""

    def __init__(self, session: zenoh.Session, fleet: str, name: str, paths: Iterable[str | Path] = ()) -> None:
        self._session, self._name, self._paths = session, name, ("/", *paths)
        self._key, self._instance = keys.HOST.key(fleet, name), str(session.info.zid())
        self._queryable: Any = None

    def start(self) -> None:
        self._queryable = self._session.declare_queryable(self._key, self._on_query)

    def close(self) -> None:
        self._queryable.undeclare()

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            told = report(self._name, self._instance, self._paths)
            query.reply(self._key, wire.encode(told), encoding=keys.JSON)
