"""``msg/{MSG}``: the last message of a name, decoded when somebody asks."""

from __future__ import annotations

from typing import Any

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput
from zmav.mavlink import describe
from zmav.services.identity import Identity
from zmav.services.port import Port
from zmav.services.timesync import TimeSync

KEY_DEPTH = 4  # zmav/fleet/vehicle/msg/NAME


class Messages:
    """Answers queries in Zenoh's own threads; the autopilot's message is preferred to another component's."""

    def __init__(self, session: zenoh.Session, port: Port, identity: Identity, timesync: TimeSync) -> None:
        self._session, self._port, self._identity, self._timesync = session, port, identity, timesync
        self._queryable: Any = None

    def start(self) -> None:
        key = keys.MSG.key(self._port.fleet, self._port.name, msg="*")
        self._queryable = self._session.declare_queryable(key, self._on_query)

    def close(self) -> None:
        self._queryable.undeclare()

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            asked = str(query.key_expr)
            if "*" in asked:
                for name in self._port.names():
                    key = self._key(name)
                    if query.key_expr.intersects(key):
                        self._reply(query, name)
                return
            self._reply(query, asked.split("/")[KEY_DEPTH])

    def _key(self, name: str) -> str:
        return keys.MSG.key(self._port.fleet, self._port.name, msg=name)

    def _reply(self, query: zenoh.Query, name: str) -> None:
        try:
            answer = self._last(name)
        except BadInput as e:
            query.reply_err(wire.error_body(e), encoding=keys.JSON)
            return
        query.reply(self._key(name), wire.encode(answer), encoding=keys.JSON)

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
