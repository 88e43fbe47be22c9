"""``alive``: the token that says a vehicle is present, and the watch for a second one of its name or system id.

Anybody can declare a token. So a vehicle that has credentials is stopped only by who proves to be that other vehicle:
it is asked for its state, which must be signed, of that very process, and answer a challenge.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable, Iterator
from typing import Any

import zenoh

from zmav import keys, wire
from zmav.errors import BadKey, Clash, ZmavError
from zmav.services.companion import Companion
from zmav.services.link.identity import Identity, VehicleChanged
from zmav.services.queries.everybody import challenge_vehicle
from zmav.tokens import TokenTable
from zmav.trust.certificate import Role
from zmav.trust.proof import Signer
from zmav.trust.verify import Verifier
from zmav.waiting import on_loop

NOBODY = "-"
UID_GRACE = 2.0
"""seconds an autopilot has to tell its uid before its token goes out without one"""


class Presence:
    """One vehicle's token, and everybody else's. On the event loop; :meth:`check` from any thread."""

    ask_every = 2.0
    """seconds between two of those who seem to clash with us being asked who they are"""

    def __init__(self, companion: Companion, instance: str, verifier: Verifier | None, signer: Signer | None) -> None:
        self._session, self._identity, self._events = companion.session, companion.identity, companion.events
        self._fleet, self._name, self._bus = companion.port.fleet, companion.port.name, companion.port.bus
        self.instance, self._verifier, self._signer = instance, verifier, signer
        self._role = keys.REPLAY if keys.is_replay(self._fleet) else keys.VEHICLE
        self.clash: str | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._token_key = ""
        self.others: TokenTable[str, dict[str, str]] = TokenTable(
            self._is_known, lambda token: _who(token) in self._proven
        )
        """the parts of other vehicles' tokens; no flood takes the place of one that is proven"""
        self._proven: set[tuple[str, str]] = set()
        """(vehicle, instance) of others that have proven to be who their tokens say"""
        self._asked, self._turn = 0.0, 0
        self._subscriber: Any = None
        self._since = 0.0

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        everyone = keys.ALIVE.key(self._fleet, "*", role=self._role, sys="*", autopilot="*", uid="*", instance="*")
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
        self._ask(now)

    def _declare(self, known: Identity | None) -> None:
        key = keys.ALIVE.key(
            self._fleet,
            self._name,
            role=self._role,
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
        try:
            parts = keys.match(key)[1]
        except BadKey:
            return  # anybody can declare a token: no vehicle has such a name
        if parts["instance"] == self.instance:
            return
        believed = self._is_believed(parts)
        if sample.kind == zenoh.SampleKind.PUT:
            news = self.others.add(parts["vehicle"], key, parts)
        else:
            news = self.others.remove(parts["vehicle"], key)
            if not self._is_there(_who(parts)):  # one that says more may be there
                self._proven.discard(_who(parts))
        if news and believed and self._conflict(parts):  # others change nothing, however many come
            self._judge()

    def _is_known(self, vehicle: str) -> bool:
        return self._verifier is None or self._verifier.is_vehicle(self._fleet, vehicle)

    def _is_believed(self, token: dict[str, str]) -> bool:
        return self._verifier is None or _who(token) in self._proven

    def _is_there(self, who: tuple[str, str]) -> bool:
        return any(_who(other) == who for other in self.others.of(who[0]))

    def _tokens(self, vehicles: Iterable[str]) -> Iterator[dict[str, str]]:
        return (token for vehicle in vehicles for token in self.others.of(vehicle))

    def _judge(self) -> None:
        tokens = self._tokens(self.others)
        clash = self._identity.clash or next(filter(None, map(self._conflict, filter(self._is_believed, tokens))), None)
        if clash == self.clash:
            return
        if clash:
            self._events.emit("clash", "critical", f"{clash}: commands are refused until one of them is gone")
        else:
            self._events.emit("clash", "notice", f"the clash is over ({self.clash})")
        self.clash = clash
        self._bus.tell(VehicleChanged())

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

    def _ask(self, now: float) -> None:
        """Have one of those who seem to clash with us prove who it is, each in its turn."""
        if self._verifier is None or now - self._asked < self.ask_every:
            return
        # Who is not on our roster may be on a newer one, and comes after those who are.
        # Whose tokens are a crowd may have a true one that gave way to others.
        suspects = [who for who, _ in self._suspects(self.others)] + self.others.crowded()
        suspects = suspects or [who for who, _ in self._suspects(self.others.strangers())]
        if not suspects:
            return
        self._asked, self._turn = now, self._turn + 1
        vehicle, verifier = suspects[self._turn % len(suspects)], self._verifier
        proven = on_loop(asyncio.get_running_loop(), self._on_proven)

        def on_state(key: str, payload: bytes, proof: bytes | None, challenge: bytes) -> None:
            with contextlib.suppress(ZmavError):
                _, by = verifier.verify_answer(key, payload, proof, challenge)
                state = wire.decode(payload, wire.VehicleState, f"state of {vehicle}")
                if (by.name, by.role) == (vehicle, Role.VEHICLE) and state.instance != self.instance:
                    proven((vehicle, state.instance))

        place = (self._fleet, vehicle)
        challenge_vehicle(self._session, place, on_state, timeout=self.ask_every, signer=self._signer)

    def _suspects(self, vehicles: Iterable[str]) -> list[tuple[str, str]]:
        found = ((_who(token), token) for token in self._tokens(vehicles))
        return [who for who, token in found if who not in self._proven and self._conflict(token)]

    def _on_proven(self, who: tuple[str, str]) -> None:
        if self._is_there(who):
            self.others.settle(who[0])
            self._proven.add(who)
            self._judge()
        elif who[0] in self.others.crowded():
            self._find(*who)

    def _find(self, vehicle: str, instance: str) -> None:
        """Look for the token of who has proven to be there, among those that gave way to a flood."""
        found = on_loop(asyncio.get_running_loop(), self._on_found)

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                found(str(reply.ok.key_expr), (vehicle, instance))

        key = keys.ALIVE.key(self._fleet, vehicle, role=self._role, sys="*", autopilot="*", uid="*", instance=instance)
        self._session.liveliness().get(key, on_reply, timeout=self.ask_every)

    def _on_found(self, key: str, who: tuple[str, str]) -> None:
        with contextlib.suppress(BadKey):
            self._proven.add(who)
            self.others.add(who[0], key, keys.match(key)[1])
            self._on_proven(who)

    def check(self) -> None:
        """Raise :class:`Clash` while nobody may command this vehicle."""
        if self.clash:
            raise Clash(f"refused: {self.clash}", vehicle=self._name)


def _who(token: dict[str, str]) -> tuple[str, str]:
    return token["vehicle"], token["instance"]
