"""What stands between an order and its handler on a vehicle: who may give it now, and what it takes the place of."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from zmav import wire
from zmav.errors import Refused
from zmav.services.authority.authority import Authority, moves_nothing
from zmav.services.orders.orders import Guarded, Report
from zmav.trust.gate import Origin
from zmav.verbs import Access, Verb

Judge = Callable[[Any, Report], Awaitable[None]]


class OrderPermit:
    """Puts each verb's handler behind what the verb needs: no clash of names or ids, and the lease where there is one.

    ``judges``, by verb, raise where the order cannot be done: what it would end goes on then. On the event loop.
    """

    def __init__(self, authority: Authority, judges: Mapping[str, Judge]) -> None:
        self._authority, self._judges = authority, judges
        self._came = itertools.count(1)
        """numbers the orders as they come"""
        self._newest = 0
        """the highest number of an order that has begun and makes the vehicle safe or moves it"""

    def __call__(self, verb: Verb, handler: Guarded) -> Guarded:
        authority, judge = self._authority, self._judges.get(verb.name)

        async def permitted(args: wire.Order, report: Report, origin: Origin | None) -> dict[str, Any]:
            number = next(self._came)
            authority.allow(verb, args, origin)
            if judge is not None:
                await judge(args, report)  # which may take its time
                if self._newest > number:
                    text = f"{verb.name} was overtaken: the vehicle was ordered otherwise meanwhile"
                    raise Refused(f"{text}; give it again if it is still wanted")
                authority.allow(verb, args, origin)
            flown = authority.begin(verb, args, origin)
            if verb.access is Access.OPEN or (verb.access is Access.MOVE and not moves_nothing(verb, args)):
                self._newest = max(self._newest, number)
            try:
                return await handler(args, report, origin)
            except Exception as e:
                if isinstance(e, Refused) and "mode" in e.detail:  # it saw the pilot's mode before anybody judged it
                    authority.taken(e.message)
                authority.failed(flown, verb)
                raise
            except asyncio.CancelledError:
                if authority.taken_from:
                    raise authority.taken_over() from None
                raise

        return permitted
