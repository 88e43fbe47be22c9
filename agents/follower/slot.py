"""A place relative to a target, for one vehicle at a time: liveliness tokens in which the first one wins.

Nobody arbitrates, so that nobody need be reached. Who finds the slot taken is refused. Two that take it at once, or on
the two sides of a torn network, see each other's tokens later: the one with the earlier claim keeps it.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from collections.abc import Callable
from typing import Any

import zenoh

from zmav import keys
from zmav.errors import BadKey, Refused
from zmav.services.link.port import on_loop
from zmav.tokens import TokenTable, find_tokens
from zmav.waiting import in_thread, within

SETTLE = 0.5
"""s in which two that ask at once hear of each other"""
LEAVES = 2.0
"""s in which the token of who has just left the slot is gone everywhere"""
MOST_GONE = 64
"""tokens that are remembered to have gone"""
Claim = tuple[int, str]
"""when (UTC ms), and which instance"""


class Slot:
    """``async with Slot(session, z.is_vehicle, "demo", "quad1", "rover1", "above") as slot``. Raises :class:`Refused`
    naming who has it: only a vehicle can. ``on_lost``: told who has the better claim, where that shows later.
    """

    def __init__(
        self,
        session: zenoh.Session,
        is_vehicle: keys.IsVehicle,
        fleet: str,
        vehicle: str,
        target: str,
        slot: str,
        on_lost: Callable[[str], None] = lambda who: None,
    ) -> None:
        self._session, self._fleet, self._vehicle, self._on_lost = session, fleet, vehicle, on_lost
        self._target, self._slot = keys.check_name(target, "target"), keys.check_name(slot, "slot")
        self._claim: Claim = (int(1e3 * time.time()), uuid.uuid4().hex)
        self._others: TokenTable[str, tuple[Claim, str]] = TokenTable(
            lambda who: is_vehicle(fleet, who), lambda claim: -claim[0][0]
        )
        self._token: zenoh.LivelinessToken | None = None
        self._subscriber: Any = None
        self._free = asyncio.Event()
        self._gone: set[str] = set()
        """keys of tokens that were said to be gone"""

    async def __aenter__(self) -> Slot:
        wide = self._key("*", ("*", "*"))
        take = on_loop(asyncio.get_running_loop(), self._on_token)
        self._subscriber = self._session.liveliness().declare_subscriber(wide, take, history=True)
        try:
            await asyncio.sleep(SETTLE)
            if self._claims():
                await self._forget_gone(wide)
            if self._claims():
                with contextlib.suppress(asyncio.TimeoutError):
                    await within(LEAVES, self._free.wait())
            if claims := self._claims():
                raise self._taken(min(claims)[1])
            self._token = self._session.liveliness().declare_token(self._key(self._vehicle, self._claim))
            await asyncio.sleep(SETTLE)
            if who := self.better:
                raise self._taken(who)
        except BaseException:
            self._drop()
            raise
        return self

    async def __aexit__(self, *exc: object) -> None:
        self._drop()

    @property
    def better(self) -> str:
        """Who has the better claim; empty: it is ours."""
        first = min(self._claims(), default=None)
        return first[1] if first is not None and first[0] < self._claim else ""

    def _drop(self) -> None:
        for held in (self._token, self._subscriber):
            if held is not None:
                held.undeclare()
        self._token = self._subscriber = None

    def _key(self, vehicle: str, claim: tuple[int | str, str]) -> str:
        since, instance = claim
        return keys.SLOT.key(self._fleet, vehicle, target=self._target, slot=self._slot, since=since, instance=instance)

    async def _forget_gone(self, wide: str) -> None:
        """Forget the claims that were said to be gone, and are.

        Zenoh hands the history of a session's second subscriber over in a thread of its own, and so may tell of a token
        when it has told already that the token is gone. Neither that nor its list of those that are there is proof
        enough alone: a token comes back when a link does, and of two lists asked for at once one may lack some.
        """
        doubtful = {
            key: vehicle for claim, vehicle in self._claims() if (key := self._key(vehicle, claim)) in self._gone
        }
        if doubtful:
            with contextlib.suppress(TimeoutError):
                for key in doubtful.keys() - set(await in_thread(find_tokens, self._session, wide, LEAVES, True)):
                    self._others.remove(doubtful[key], key)

    def _taken(self, who: str) -> Refused:
        text = f"{who} keeps the place {self._slot} {self._target} already: end that one first"
        return Refused(text, holder=who, target=self._target, slot=self._slot)

    def _on_token(self, sample: zenoh.Sample) -> None:
        try:
            _, parts = keys.match(str(sample.key_expr))
            claim = (int(parts["since"]), parts["instance"])
        except (BadKey, ValueError):
            return
        if claim == self._claim:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            self._others.add(parts["vehicle"], str(sample.key_expr), (claim, parts["vehicle"]))
            if self._token is not None and claim < self._claim and (who := self.better):
                self._on_lost(who)
        else:
            self._others.remove(parts["vehicle"], str(sample.key_expr))
            if len(self._gone) < MOST_GONE:
                self._gone.add(str(sample.key_expr))
            if not self._claims():
                self._free.set()

    def _claims(self) -> list[tuple[Claim, str]]:
        return [claim for vehicle in self._others for claim in self._others.of(vehicle)]
