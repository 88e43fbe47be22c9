"""A place relative to a target, for one vehicle at a time: liveliness tokens in which the first one wins.

Nobody arbitrates, so that nobody need be reached. Who finds the slot taken is refused. Two that take it at once, or on
the two sides of a torn network, see each other's tokens later: the one with the earlier claim keeps it.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Callable
from typing import Any

import zenoh

from zmav import keys
from zmav.errors import BadKey, Refused
from zmav.tokens import TokenTable, find_tokens
from zmav.waiting import in_thread, on_loop

SETTLE = 0.5
"""s in which two that ask at once hear of each other"""
AGAIN = 0.1
"""s until it is looked for again"""
Claim = tuple[int, str]
"""when (UTC ms), and which instance"""
Claimed = tuple[Claim, str]
"""and of which vehicle"""


class Slot:
    """``async with Slot(session, z.is_vehicle, "demo", "quad1", "rover1", "above") as slot``. Raises :class:`Refused`
    naming who has it: only a vehicle can. ``on_lost``: told who has the better claim, where that shows later.
    """

    leaves = 2.0
    """s in which the token of who has just left the slot is gone everywhere"""

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
        self._is_vehicle = is_vehicle
        self._target, self._slot = keys.check_name(target, "target"), keys.check_name(slot, "slot")
        self._claim: Claim = (int(1e3 * time.time()), uuid.uuid4().hex)
        self._others: TokenTable[str, Claimed] = TokenTable(
            lambda who: is_vehicle(fleet, who), lambda claim: -claim[0][0]
        )
        self._token: zenoh.LivelinessToken | None = None
        self._subscriber: Any = None

    async def __aenter__(self) -> Slot:
        end = time.monotonic() + self.leaves
        while claims := await self._find_claims():
            if time.monotonic() > end:
                raise self._taken(min(claims)[1])
            await asyncio.sleep(AGAIN)
        liveliness = self._session.liveliness()
        take = on_loop(asyncio.get_running_loop(), self._on_token)
        try:
            self._subscriber = liveliness.declare_subscriber(self._key("*", ("*", "*")), take, history=True)
            self._token = liveliness.declare_token(self._key(self._vehicle, self._claim))
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

    async def _find_claims(self) -> list[Claimed]:
        """Who claims the slot. It is asked for: who subscribes just as a token goes may be told that it is gone before
        it is told that it was there, as routers send such things from two threads, and believes it for ever.
        """
        found = await in_thread(find_tokens, self._session, self._key("*", ("*", "*")), self.leaves)
        read = [self._read(key) for key in found]
        return [claim for claim in read if claim is not None and self._is_vehicle(self._fleet, claim[1])]

    @staticmethod
    def _read(key: str) -> Claimed | None:
        try:
            _, parts = keys.match(key)
            return (int(parts["since"]), parts["instance"]), parts["vehicle"]
        except (BadKey, ValueError):
            return None

    def _taken(self, who: str) -> Refused:
        text = f"{who} keeps the place {self._slot} {self._target} already: end that one first"
        return Refused(text, holder=who, target=self._target, slot=self._slot)

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        read = self._read(key)
        if read is None or read[0] == self._claim:
            return
        claim, vehicle = read
        if sample.kind == zenoh.SampleKind.PUT:
            self._others.add(vehicle, key, read)
            if self._token is not None and claim < self._claim and (who := self.better):
                self._on_lost(who)
        else:
            self._others.remove(vehicle, key)

    def _claims(self) -> list[Claimed]:
        return [claim for vehicle in self._others for claim in self._others.of(vehicle)]
