"""Where orders to the planner are given: find the one in charge, ask it, watch what becomes of goals."""

from __future__ import annotations

import asyncio
import fnmatch
import math
import time
import uuid
from collections.abc import AsyncIterator
from typing import Any

import msgspec

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, NoSuchVehicle, Refused
from zmav.subscription import document
from zmav.swarm import BEAT, order_planner, planner_in_charge
from zmav.tokens import find_tokens
from zmav.wire import swarm

LOOK, TAKES_OVER = 2.0, 8.0
"""s for a planner to say that it is in charge, which it does three times a second, and for tokens; and for one that
stands by to take charge"""
ANSWER = 3.0
NOBODY = (
    "no planner is in charge of fleet {fleet}: start one with 'zmav swarm planner', beside 'zmav router' or 'zmav up'"
)


class Planner:
    """The planner in charge, as its callers see it."""

    def __init__(self, z: zmav.Client, status: dict[str, Any]) -> None:
        self._z, self.status = z, status
        self.name = str(status["planner"])

    @property
    def vehicles(self) -> list[str]:
        """Those that it knows: heard in the last half minute."""
        return [str(name) for name in self.status.get("vehicles", [])]

    def names(self, patterns: tuple[str, ...] | list[str]) -> list[str]:
        """The vehicles that patterns mean. Raises :class:`BadInput` for one that means none."""
        found = match_names(list(patterns), self.vehicles)
        for pattern in patterns:
            if not match_names([pattern], self.vehicles):
                known = ", ".join(self.vehicles) or "none"
                text = f"no vehicle is called {pattern}; {self.name} knows: {known}"
                raise BadInput(text, field="vehicles", value=pattern, expected=known)
        return found

    def one_each(self, patterns: list[str]) -> list[str]:
        """The vehicle of each pattern. Raises :class:`BadInput` for one that means none, several, or another's."""
        found: list[str] = []
        for pattern in patterns:
            meant = self.names([pattern])
            if len(meant) > 1 or meant[0] in found:
                text = f"{pattern} means {', '.join(meant)}" if len(meant) > 1 else f"{meant[0]} has two places"
                text += ": give each vehicle one place, by its own name"
                raise BadInput(text, field="vehicles", value=pattern, expected="each vehicle once")
            found += meant
        return found

    async def order(self, verb: str, order: wire.Order) -> dict[str, Any]:
        """Ask until it says how it ended; raises its typed error, or :class:`TimedOut` when it is silent."""
        order, z = msgspec.structs.replace(order, id=uuid.uuid4().hex), self._z
        return await order_planner(z, z.fleet_name, self.name, verb, order, answer_s=ANSWER, silent=3, ends=math.inf)


async def find(z: zmav.Client) -> Planner:
    """The planner in charge, by its own word; raises :class:`NoSuchVehicle` where there is none, saying what to do."""
    fleet = z.fleet_name
    if fleet == "*":
        raise BadInput("say which fleet: --fleet NAME", field="fleet", value="*", expected="one fleet")
    found = await planner_in_charge(z, fleet, LOOK, BEAT)
    others, ends = await planners(z) if found is None else [found[1]], time.monotonic() + TAKES_OVER
    if not others:
        raise NoSuchVehicle(NOBODY.format(fleet=fleet), fleet=fleet)
    while True:
        if found is not None:
            chief = Planner(z, await Planner(z, {"planner": found[1]}).order("status", wire.Order()))
            if chief.status.get("in_charge"):  # and has not stepped down since
                return chief
        if (left := ends - time.monotonic()) <= 0.0:
            text = f"{', '.join(others)}: standing by, and nobody is in charge yet; ask again in a few seconds"
            raise Refused(text, standby=others)
        found = await planner_in_charge(z, fleet, left, BEAT)


async def planners(z: zmav.Client) -> list[str]:
    """The names of all planners, in charge or standing by."""
    key = keys.ALIVE.key(z.fleet_name, "*", role="planner", sys=0, autopilot="*", uid="-", instance="*")
    tokens = await asyncio.to_thread(find_tokens, z.session, key, LOOK)
    return sorted({keys.match(token)[1]["vehicle"] for token in tokens})


async def books(z: zmav.Client, silence: float) -> AsyncIterator[swarm.Book | None]:
    """Each book of the planner in charge as it comes; None when none came for ``silence`` seconds."""

    highest = 0
    async with z.subscribe(keys.FLEET.key(z.fleet_name, topic="goal"), document(swarm.Book), depth=10) as told:
        while True:
            try:
                _, book = await zmav.waiting.within(silence, told.get())
            except asyncio.TimeoutError:
                yield None
                continue
            if book.term >= highest:
                highest = book.term
                yield book


def match_names(patterns: list[str], names: list[str]) -> list[str]:
    """The names that the patterns mean (``quad*``, ``all``), in the patterns' order, each once; a name that is no
    pattern as it is, known or not.
    """
    found: list[str] = []
    for pattern in patterns:
        if pattern == "all" and "all" not in names:
            pattern = "*"
        found += [pattern] if not set("*?[") & set(pattern) else sorted(fnmatch.filter(names, pattern))
    return list(dict.fromkeys(found))
