"""``msg/{MSG}``: the last message of a name, decoded when somebody asks."""

from __future__ import annotations

from collections.abc import Iterator

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput
from zmav.mavlink import describe
from zmav.services.link.identity import Identity
from zmav.services.link.port import Port
from zmav.services.link.timesync import TimeSync
from zmav.services.queries.questions import Questions, Reply

KEY_DEPTH = 4  # zmav/fleet/vehicle/msg/NAME


class Messages:
    """Answers in the lane of questions; the autopilot's message is preferred to another component's."""

    def __init__(self, questions: Questions, port: Port, identity: Identity, timesync: TimeSync) -> None:
        self._port, self._identity, self._timesync = port, identity, timesync
        questions.declare(keys.MSG.key(port.fleet, port.name, msg="*"), self._answer)

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
            raise BadInput(
                f"no {name} has come from {self._port.name}; heard so far: {heard}",
                field="msg",
                value=name,
                expected="a message the vehicle sends",
            )
        frame, age, total = found
        m = describe(frame, self._port.dialect)
        own = source is not None and (frame.sysid, frame.compid) == source  # another's boot time is not the autopilot's
        t, t_error = self._timesync.stamp(m.fields) if own else (None, None)
        return wire.LastMessage(
            name=m.name,
            id=m.id,
            sysid=m.sysid,
            compid=m.compid,
            seq=m.seq,
            age=age,
            t=t,
            t_error=t_error,
            count=total,
            signed=m.signed,
            verified=m.verified,
            fields=m.fields,
            units=m.units,
        )
