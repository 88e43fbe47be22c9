"""``alive``: the token that says a vehicle is present, and the watch for a second one of its name or system id."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import zenoh

from zmav import keys
from zmav.errors import Clash
from zmav.services.events import Events
from zmav.services.identity import Identity
from zmav.services.port import on_loop

NOBODY = "-"
UID_GRACE = 2.0
"""seconds an autopilot has to tell its uid before its token goes out without one"""


class Presence:
    """One vehicle's token, and everybody else's. On the event loop; :meth:`check` from any thread."""

    def __init__(
        self, session: zenoh.Session, fleet: str, name: str, instance: str, identity: Identity, events: Events
    ) -> None:
        self._session, self._fleet, self._name, self.instance = session, fleet, name, instance
        self._identity, self._events = identity, events
        self.clash: str | None = None
        self.on_change: Callable[[], None] = lambda: None
        self._token: zenoh.LivelinessToken | None = None
        self._token_key = ""
        self._others: dict[str, dict[str, str]] = {}
        self._subscriber: Any = None
        self._since = 0.0

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        everyone = keys.ALIVE.key(self._fleet, "*", role=keys.VEHICLE, sys="*", autopilot="*", uid="*", instance="*")
        self._subscriber = self._session.liveliness().declare_subscriber(
            everyone, on_loop(loop, self._on_token), history=True
        )
        self.tick()

    def close(self) -> None:
        self._subscriber.undeclare()
        if self._token is not None:
            self._token.undeclare()

    def tick(self) -> None:
        """Renew the token where what it says has changed, and judge who else is there."""
        now = asyncio.get_running_loop().time()
        known = self._identity if self._identity.connected else None
        if known is None:
            self._since = now
        if known is None or known.uid is not None or now - self._since > UID_GRACE:
            self._declare(known)
        self._judge()

    def _declare(self, known: Identity | None) -> None:
        key = keys.ALIVE.key(
            self._fleet,
            self._name,
            role=keys.VEHICLE,
            sys=known.source[0] if known and known.source else 0,
            autopilot=known.autopilot.name if known and known.autopilot else NOBODY,
            uid=(known.uid if known else None) or NOBODY,
            instance=self.instance,
        )
        if key != self._token_key:
            token = self._session.liveliness().declare_token(key)
            if self._token is not None:
                self._token.undeclare()
            self._token, self._token_key = token, key

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        _, parts = keys.match(key)
        if parts["instance"] == self.instance:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._others[key] = parts
        else:
            self._others.pop(key, None)
        self._judge()

    def _judge(self) -> None:
        clash = self._identity.clash or next(filter(None, map(self._conflict, self._others.values())), None)
        if clash == self.clash:
            return
        if clash:
            self._events.emit("clash", "critical", f"{clash}: commands are refused until one of them is gone")
        else:
            self._events.emit("clash", "notice", f"the clash is over ({self.clash})")
        self.clash = clash
        self.on_change()

    def _conflict(self, other: dict[str, str]) -> str | None:
        """What is wrong between us and the vehicle of that token, in words."""
        if other["vehicle"] == self._name:
            return f"another vehicle is named {self._name}"
        mine = self._identity
        if not mine.connected or mine.source is None or other["sys"] != str(mine.source[0]):
            return None
        if mine.uid is not None and other["uid"] == mine.uid:
            return None  # one autopilot, heard by two companions
        if keys.match(self._token_key)[1]["sys"] != other["sys"]:
            return None  # we have not yet said who we are: the uids can be compared in a moment
        return f"{other['vehicle']} and {self._name} both have system id {mine.source[0]}"

    def check(self) -> None:
        """Raise :class:`Clash` while nobody may command this vehicle."""
        if self.clash:
            raise Clash(f"refused: {self.clash}", vehicle=self._name)
