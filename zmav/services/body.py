"""``body``: how much room the vehicle needs and what it can do, for whoever plans for it."""

from __future__ import annotations

from typing import Any

import zenoh

from zmav import keys, wire
from zmav.config import BodyConfig, body_of
from zmav.services.identity import Identity
from zmav.services.port import Port


class BodyService:
    """Answers in Zenoh's own threads."""

    def __init__(self, session: zenoh.Session, port: Port, identity: Identity, declared: BodyConfig | None) -> None:
        self._session, self._identity, self._declared = session, identity, declared
        self._key = keys.BODY.key(port.fleet, port.name)
        self._queryable: Any = None

    def start(self) -> None:
        self._queryable = self._session.declare_queryable(self._key, self._on_query)

    def close(self) -> None:
        self._queryable.undeclare()

    @property
    def body(self) -> wire.swarm.Body:
        """By the fleet file, and for the rest as is usual for the kind that was heard."""
        return body_of(self._identity.kind, self._declared)

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            report = wire.swarm.BodyReport(
                kind=self._identity.kind, body=self.body, declared=self._declared is not None
            )
            query.reply(self._key, wire.encode(report), encoding=keys.JSON)
