"""What is looked at when somebody asks: ``body`` (the room that a vehicle needs and what it can do), ``host`` (how its
computer is), ``msg/{MSG}`` (the last message of a name, decoded) and ``schema/{name}`` (what all of that is).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import zenoh

from zmav import keys, wire
from zmav.config import BodyConfig, Failsafe, body_of
from zmav.errors import BadInput
from zmav.host import report
from zmav.mavlink import describe
from zmav.services.queries.questions import Questions, Reply

if TYPE_CHECKING:  # a ground host's router tells of its computer alone
    from zmav.services.companion import Companion
    from zmav.services.link.timesync import TimeSync

KEY_DEPTH = 4  # zmav/fleet/vehicle/msg/NAME


class Messages:
    """Answers in the lane of questions; the autopilot's message is preferred to another component's."""

    def __init__(self, companion: Companion, timesync: TimeSync) -> None:
        self._port, self._identity, self._timesync = companion.port, companion.identity, timesync
        companion.questions.declare(keys.MSG.key(companion.port.fleet, companion.port.name, msg="*"), self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        asked = str(query.key_expr)
        if "*" not in asked:
            name = asked.split("/")[KEY_DEPTH]
            yield Reply(self._key(name), wire.encode(self._last(name)))
            return
        for name in self._port.names():
            if query.key_expr.intersects(self._key(name)):
                yield Reply(self._key(name), wire.encode(self._last(name)))

    def _key(self, name: str) -> str:
        return keys.MSG.key(self._port.fleet, self._port.name, msg=name)

    def _last(self, name: str) -> wire.LastMessage:
        source = self._identity.source
        found = (source and self._port.latest(name, source)) or self._port.newest(name)
        if not found:
            heard = ", ".join(self._port.names()) or "nothing yet"
            text = f"no {name} has come from {self._port.name}; heard so far: {heard}"
            raise BadInput(text, field="msg", value=name, expected="a message the vehicle sends")
        frame, age, total = found
        message = msgspec.structs.asdict(describe(frame, self._port.dialect))
        own = source is not None and (frame.sysid, frame.compid) == source  # another's boot time is not the autopilot's
        t, t_error = self._timesync.stamp(message["fields"]) if own else (None, None)
        return wire.LastMessage(age=age, t=t, t_error=t_error, count=total, **message)


class SchemaService:
    """Answers in the lane of questions what its key space is, as programs read it."""

    def __init__(self, companion: Companion) -> None:
        self._fleet, self._name = companion.port.fleet, companion.port.name
        companion.questions.declare(keys.SCHEMA.key(self._fleet, self._name, schema="*"), self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        *_, kind, asked = str(query.key_expr).split("/")
        if "*" in asked and kind != "schema":
            return  # somebody looks around, who wants no document
        from zmav import schemas  # seldom asked, and some work to load

        name = schemas.ASYNCAPI if "*" in asked else asked
        document = schemas.asyncapi() if name == schemas.ASYNCAPI else schemas.payload_schema(name)
        yield Reply(keys.SCHEMA.key(self._fleet, self._name, schema=name), msgspec.json.encode(document))


class BodyService:
    """Answers in the lane of questions."""

    def __init__(self, companion: Companion, declared: BodyConfig | None, failsafe: Failsafe) -> None:
        self._identity, self._declared, self._failsafe = companion.identity, declared, failsafe
        self._key = keys.BODY.key(companion.port.fleet, companion.port.name)
        companion.questions.declare(self._key, self._answer)

    @property
    def body(self) -> wire.swarm.Body:
        """By the fleet file, and for the rest as is usual for the kind that was heard."""
        return body_of(self._identity.kind, self._declared)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        told = wire.swarm.BodyReport(
            kind=self._identity.kind,
            body=self.body,
            declared=self._declared is not None,
            returns_after=self._failsafe.returns_after,
        )
        yield Reply(self._key, wire.encode(told))


class HostService:
    """Answers in the lane of questions; ``paths`` are on the file systems that matter here."""

    def __init__(
        self, questions: Questions, instance: str, fleet: str, name: str, paths: Iterable[str | Path] = ()
    ) -> None:
        self._instance, self._name, self._paths = instance, name, ("/", *paths)
        self._key = keys.HOST.key(fleet, name)
        questions.declare(self._key, self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        yield Reply(self._key, wire.encode(report(self._name, self._instance, self._paths)))
