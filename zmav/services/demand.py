"""Who wants which message at which rate: liveliness tokens of readers, and plain subscribers found in the admin space.

A token ``want/{msg}/{hz}/{instance}`` says it all and is heard at once, from wherever in the mesh; it goes with its
reader, or with the reader's session. A plain subscriber (a Zenoh command line, somebody's script) says no rate, but the
router's own admin space lists the key expressions of all subscribers, those behind other routers included: one that
names a message is a reader at :data:`PLAIN_HZ`, while ``*`` and ``**`` (a recorder, a bridge) take what flows anyway.

Why not Zenoh's matching status: it needs a publisher declared for each message that might be wanted, some three hundred
a vehicle, and tells that there is a subscriber but not whether it asked for everything. One look into the admin space
costs the router's process less than a tenth of a millisecond, and under one with 500 subscribers in the network.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh
from zenoh import handlers

from zmav import keys
from zmav.mavlink import Dialect
from zmav.services.port import Port, on_loop

PLAIN_HZ = 4.0
"""the rate a subscriber without a token is taken to want"""
MAX_HZ = 500.0
FEW = 8
"""messages that a ``$*`` in a subscriber's last chunk may match to count as naming them"""
MAX_ID = 0xFFFFFF
UNKNOWN = re.compile(r"UNKNOWN_([0-9]{1,8})\Z")
MANY = 1024
"""tokens and expressions remembered; beyond it, they are left out"""
NOT_STREAMED = {
    "HEARTBEAT", "STATUSTEXT", "PARAM_VALUE", "TIMESYNC", "AUTOPILOT_VERSION", "MESSAGE_INTERVAL",
    "MISSION_ITEM_REACHED", "CAMERA_IMAGE_CAPTURED", "LOG_ENTRY", "LOG_DATA",
}  # fmt: skip
"""answers, events and the heartbeat: who subscribes to them wants them when they come (those with a target, too)"""


class Demand(NamedTuple):
    """One reader of one message."""

    name: str
    hz: float
    reader: str
    explicit: bool
    """by a token; False: a plain subscriber"""


class Demands:
    """The readers of one vehicle's messages. Lives on the event loop; ``on_change`` is called at once for tokens."""

    def __init__(self, session: zenoh.Session, port: Port) -> None:
        self._session, self._port = session, port
        self.on_change: Callable[[], None] = lambda: None
        self.sees_subscribers = False
        """this session is a router's: it has an admin space to look into"""
        self.junk = 0
        self._tokens: dict[str, Demand] = {}
        self._plain: list[Demand] = []
        self._known: dict[tuple[str, tuple[int, int]], tuple[str, ...]] = {}
        self._subscriber: Any = None
        self._admin = f"@/{session.info.zid()}/router/subscriber/"
        self._asking = False

    def start(self) -> None:
        heard = on_loop(asyncio.get_running_loop(), self._on_token)
        key = keys.WANT.key(self._port.fleet, self._port.name, msg="*", hz="*", instance="*")
        self._subscriber = self._session.liveliness().declare_subscriber(key, heard, history=True)
        router = self._admin.removesuffix("/subscriber/")
        self.sees_subscribers = any(reply.ok for reply in self._session.get(router, timeout=1.0))

    def close(self) -> None:
        self._subscriber.undeclare()

    def current(self) -> dict[str, list[Demand]]:
        """The readers by message."""
        found: dict[str, list[Demand]] = {}
        for demand in (*self._tokens.values(), *self._plain):
            found.setdefault(demand.name, []).append(demand)
        return found

    # Tokens.

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            if self._tokens.pop(key, None) is not None:
                self.on_change()
        elif key not in self._tokens:
            demand = _demand(key, self._port.dialect)
            if demand is None or len(self._tokens) >= MANY:
                self.junk += 1
                return
            self._tokens[key] = demand
            self.on_change()

    # Plain subscribers.

    def poll(self, source: tuple[int, int]) -> None:
        """Look into the admin space; what is found there counts as soon as the answer is complete."""
        if not self.sees_subscribers or self._asking:
            return
        self._asking = True
        found: list[tuple[str, bytes]] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                found.append((str(reply.ok.key_expr), reply.ok.payload.to_bytes()))

        done = on_loop(asyncio.get_running_loop(), lambda: self._take(found, source))
        # The router answers within the call itself: a queue that is read afterwards would fill up and never empty.
        handler: Any = handlers.Callback(on_reply, done, indirect=False)
        try:
            self._session.get(self._admin + self._key(source, "*"), handler)
        except zenoh.ZError:
            self._asking = False  # the session is being closed

    def _take(self, found: list[tuple[str, bytes]], source: tuple[int, int]) -> None:
        self._asking = False
        before, self._plain = self._plain, []
        for key, payload in found:
            names = self._names(key.removeprefix(self._admin), source)
            if names:
                readers = _sessions(payload, self._admin)
                self._plain += [Demand(name, PLAIN_HZ, reader, False) for name in names for reader in readers]
        if sorted(self._plain) != sorted(before):
            self.on_change()

    def _names(self, expression: str, source: tuple[int, int]) -> tuple[str, ...]:
        """The messages that a subscriber's key expression names; none where it takes whatever there is."""
        place = (expression, source)
        if place not in self._known:
            if len(self._known) >= MANY:
                self._known.clear()
            self._known[place] = self._read(expression, source)
        return self._known[place]

    def _read(self, expression: str, source: tuple[int, int]) -> tuple[str, ...]:
        last = expression.rpartition("/")[2]
        if last in ("*", "**"):
            return ()
        key, dialect = zenoh.KeyExpr(expression), self._port.dialect
        candidates = dialect.by_name if "$*" in last else (last,)
        named = [n for n in candidates if _streamed(n, dialect) and key.intersects(self._key(source, n))]
        return tuple(named) if len(named) <= FEW else ()

    def _key(self, source: tuple[int, int], name: str) -> str:
        return keys.RX.key(self._port.fleet, self._port.name, sys=source[0], comp=source[1], msg=name)


def _demand(key: str, dialect: Dialect) -> Demand | None:
    """What a token says; None where that is nothing that can be asked for. Its vehicle may be a pattern."""
    *_, name, rate, instance = key.split("/")
    try:
        hz = float(rate)
    except ValueError:
        return None
    by_number = UNKNOWN.match(name)
    if by_number and int(by_number[1]) <= MAX_ID:
        name = dialect.name_of(int(by_number[1]))
    elif name not in dialect.by_name:
        return None
    return Demand(name, hz, instance, True) if 0.0 < hz <= MAX_HZ else None


def _streamed(name: str, dialect: Dialect) -> bool:
    """It is sent at a rate, and not to somebody or once in a while."""
    message = dialect.by_name.get(name)
    return message is not None and message.target_system is None and name not in NOT_STREAMED


def _sessions(payload: bytes, admin: str) -> list[str]:
    """The sessions behind a subscription, as the admin space names them; our router stands for those it names, too."""
    own = admin.split("/")[1]
    try:
        body = json.loads(payload)
        found = {str(zid) for kind in ("routers", "peers", "clients") for zid in body.get(kind, ())} - {own}
        beside = own in body.get("clients", ())
    except (ValueError, AttributeError, TypeError):
        return ["?"]
    return sorted(zid[:8] for zid in found) + ([own[:8]] if beside else [])
