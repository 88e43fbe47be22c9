"""Who wants which message at which rate: liveliness tokens of readers, and plain subscribers found by Zenoh's matching.

A token ``want/{msg}/{hz}/{instance}`` says it all and is heard at once, from wherever in the mesh; it goes with its
reader, or with the reader's session. A plain subscriber (a Zenoh command line, somebody's script) says no rate, but a
publisher of a message knows whether anybody in the network subscribes to it: such a message has a reader at
:data:`PLAIN_HZ`. Who takes everything (a recorder, a bridge) takes what flows anyway, and asks for nothing. While one
of those is there, nobody else can be told apart from it: what was found before stays, and new plain subscribers get
what flows; readers with tokens are heard all the same.

Why not the router's own admin space, which lists all subscribers: Zenoh 1.10 answers for it under the lock of its
routing tables, and takes that lock once more to send the answer. Where a declaration comes between the two, the whole
process stands still for good (docs/mesh-proofs.md). A look at some 200 publishers costs 0.2 ms, 2 with 500 subscribers
in the network, and declaring them 2.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from zmav import keys
from zmav.mavlink import Dialect
from zmav.services.companion import Companion
from zmav.session import is_read
from zmav.waiting import on_loop

PLAIN_HZ = 4.0
"""the rate a subscriber without a token is taken to want"""
MAX_HZ = 500.0
SLOWEST = 1.0 / 60.0
"""Hz, as which anything slower counts: ArduPilot keeps no longer interval than a minute, and MAVLink none of years"""
MOST_NAMED = 40
"""messages that plain subscribers may name; with more, somebody takes whatever there is"""
NOBODYS = "NONE_OF_THEM"
"""in place of a message's name: only who takes everything subscribes to it"""
PLAIN = "subscriber"
"""what a reader without a token is called"""
MAX_ID = 0xFFFFFF
UNKNOWN = re.compile(r"UNKNOWN_([0-9]{1,8})\Z")
FASTEST = 16
"""readers of one message that are remembered, the fastest of them: who comes first has no right to stay"""
UNKNOWNS = 64
"""messages without a name that anybody may ask for"""
NOT_STREAMED = {
    "HEARTBEAT",
    "STATUSTEXT",
    "PARAM_VALUE",
    "TIMESYNC",
    "AUTOPILOT_VERSION",
    "MESSAGE_INTERVAL",
    "MISSION_ITEM_REACHED",
    "CAMERA_IMAGE_CAPTURED",
    "LOG_ENTRY",
    "LOG_DATA",
    "EVENT",
    "AVAILABLE_MODES",
}
"""answers, events and the heartbeat: who subscribes to them wants them when they come (those with a target, too)"""


class Demand(NamedTuple):
    """One reader of one message."""

    name: str
    hz: float
    reader: str
    explicit: bool
    """by a token; False: a plain subscriber"""


class Demands:
    """The readers of one vehicle's messages. Lives on the event loop; ``plan`` is called on a change."""

    ask_again = 5.0
    """s between two times that all readers are asked for again, where some were left out and there is room now"""
    quiet = 0.1
    """s between two times that changes are told: a flood of tokens is one change"""

    def __init__(self, companion: Companion, plan: Callable[[], None]) -> None:
        self._session, self._port, self._plan = companion.session, companion.port, plan
        self.junk = 0
        self.fastest = 0.0
        """Hz of the fastest reader that said one"""
        self._tokens: dict[str, dict[str, Demand]] = {}
        """by message, and by the token's key"""
        self._left_out: set[str] = set()
        """messages some of whose readers are not remembered"""
        self._asked = -self.ask_again
        self._telling: asyncio.TimerHandle | None = None
        self._told = -self.quiet
        self._plain: list[Demand] = []
        self._subscriber: Any = None
        self._source: tuple[int, int] | None = None
        self._probes: dict[str, zenoh.Publisher] = {}

    def start(self) -> None:
        """Hear of all readers that are there and that come and go. Once more: of those that were left out, too."""
        loop, before = asyncio.get_running_loop(), self._subscriber
        self._asked = loop.time()
        self._left_out.clear()
        heard = on_loop(loop, self._on_token)
        key = keys.WANT.key(self._port.fleet, self._port.name, msg="*", hz="*", instance="*")
        self._subscriber = self._session.liveliness().declare_subscriber(key, heard, history=True)
        if before is not None:
            before.undeclare()

    def close(self) -> None:
        self._subscriber.undeclare()
        if self._telling is not None:
            self._telling.cancel()
        self._forget()

    def current(self) -> dict[str, list[Demand]]:
        """The readers by message."""
        found: dict[str, list[Demand]] = {}
        for name, held in self._tokens.items():
            found[name] = list(held.values())
        for demand in self._plain:
            found.setdefault(demand.name, []).append(demand)
        return found

    # Tokens.

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        demand = demand_of(key, self._port.dialect)
        if sample.kind == zenoh.SampleKind.PUT:
            self._take(key, demand)
        elif demand is not None and self._tokens.get(demand.name, {}).pop(key, None) is not None:
            if not self._tokens[demand.name]:
                del self._tokens[demand.name]
            self._change()

    def _take(self, key: str, demand: Demand | None) -> None:
        """Remember a reader, in the place of a slower one where there is no room."""
        if demand is None or not self._has_room(demand.name):
            self.junk += 1
            return
        held = self._tokens.setdefault(demand.name, {})
        if key in held:
            return
        if len(held) >= FASTEST:
            self.junk += 1
            self._left_out.add(demand.name)
            slowest = min(held, key=lambda each: held[each].hz)
            if held[slowest].hz >= demand.hz:
                return
            del held[slowest]
        held[key] = demand
        self._change()

    def _has_room(self, name: str) -> bool:
        known = self._port.dialect.by_name
        return name in known or name in self._tokens or sum(n not in known for n in self._tokens) < UNKNOWNS

    def _change(self) -> None:
        """Have it told: at once, or a moment after the last time."""
        if self._telling is None:
            loop = asyncio.get_running_loop()
            self._telling = loop.call_at(max(loop.time(), self._told + self.quiet), self._tell)

    def _tell(self) -> None:
        self._telling, self._told = None, asyncio.get_running_loop().time()
        self.fastest = max((each.hz for held in self._tokens.values() for each in held.values()), default=0.0)
        self._plan()

    # Plain subscribers.

    def poll(self, source: tuple[int, int]) -> None:
        """Look who subscribes to messages of this (system, component)."""
        try:
            room = any(len(self._tokens.get(name, ())) < FASTEST for name in self._left_out)
            if room and asyncio.get_running_loop().time() - self._asked > self.ask_again:
                self.start()
            if source != self._source:
                self._declare(source)
            named = [name for name, probe in self._probes.items() if self._port.read and is_read(probe)]
        except zenoh.ZError:
            return  # the session is being closed
        if NOBODYS in named or len(named) > MOST_NAMED:
            return
        found = [Demand(name, PLAIN_HZ, PLAIN, False) for name in named]
        if found != self._plain:
            self._plain = found
            self._change()

    def _declare(self, source: tuple[int, int]) -> None:
        self._forget()
        dialect = self._port.dialect
        names = [NOBODYS, *sorted(name for name in dialect.by_name if _streamed(name, dialect))]
        self._probes = {name: self._session.declare_publisher(self._key(source, name)) for name in names}
        self._source = source

    def _forget(self) -> None:
        for probe in self._probes.values():
            probe.undeclare()
        self._probes, self._source = {}, None

    def _key(self, source: tuple[int, int], name: str) -> str:
        return keys.RX.key(self._port.fleet, self._port.name, sys=source[0], comp=source[1], msg=name)


def demand_of(key: str, dialect: Dialect) -> Demand | None:
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
    return Demand(name, max(hz, SLOWEST), instance, True) if 0.0 < hz <= MAX_HZ else None


def _streamed(name: str, dialect: Dialect) -> bool:
    """It is sent at a rate, and not to somebody or once in a while."""
    message = dialect.by_name.get(name)
    return message is not None and message.target_system is None and name not in NOT_STREAMED
