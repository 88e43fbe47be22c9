"""``body``: how much room the vehicle needs and what it can do, for anyone who plans for it."""

from __future__ import annotations

from collections.abc import Iterator

import zenoh

from zmav import keys, wire
from zmav.config import BodyConfig, body_of
from zmav.services.link.identity import Identity
from zmav.services.link.port import Port
from zmav.services.queries.questions import Questions, Reply


class BodyService:
    """Answers in the lane of questions."""

    def __init__(self, questions: Questions, port: Port, identity: Identity, declared: BodyConfig | None) -> None:
        self._identity, self._declared = identity, declared
        self._key = keys.BODY.key(port.fleet, port.name)
        questions.declare(self._key, self._answer)

    @property
    def body(self) -> wire.swarm.Body:
        """By the fleet file, and for the rest as is usual for the kind that was heard."""
        return body_of(self._identity.kind, self._declared)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        told = wire.swarm.BodyReport(kind=self._identity.kind, body=self.body, declared=self._declared is not None)
        yield Reply(self._key, wire.encode(told))
