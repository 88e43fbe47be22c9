"""Where orders to the planner are given: find the one in charge, ask it, watch what becomes of goals."""

from __future__ import annotations

import asyncio
import contextlib
import fnmatch
import math
import time
import uuid
from collections.abc import AsyncIterator
from typing import Any

import msgspec

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, NoSuchVehicle, Refused, ZmavError
from zmav.subscription import document
from zmav.swarm import order_planner
from zmav.tokens import find_tokens
from zmav.wire import swarm

LOOK = 1.5
"""s that planners' tokens are looked for, and that a session may take to hear of them"""
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
        order = msgspec.structs.replace(order, id=uuid.uuid4().hex)
        fleet = self._z.fleet_name
        return await order_planner(self._z, fleet, self.name, verb, order, answer_s=ANSWER, silent=3, ends=math.inf)


async def find(z: zmav.Client) -> Planner:
    """The planner in charge; raises :class:`NoSuchVehicle` where there is none, saying what to do."""
    if z.fleet_name == "*":
        raise BadInput("say which fleet: --fleet NAME", field="fleet", value="*", expected="one fleet")
    deadline, standing_by = time.monotonic() + LOOK, list[str]()
    while True:
        answers = [await _status(z, name) for name in await planners(z)]
        statuses = [answer for answer in answers if isinstance(answer, dict)]
        chiefs = [status for status in statuses if status.get("in_charge")]
        if chiefs:
            return Planner(z, max(chiefs, key=lambda status: (status.get("term", 0), status.get("instance", ""))))
        for answer in answers:
            if isinstance(answer, ZmavError):
                raise answer
        standing_by = [str(status.get("planner")) for status in statuses]
        if time.monotonic() > deadline + (8.0 if standing_by else 0.0):
            break
        await asyncio.sleep(0.25)
    if standing_by:
        text = f"{', '.join(standing_by)}: standing by, and nobody is in charge yet; ask again in a few seconds"
        raise Refused(text, standby=standing_by)
    raise NoSuchVehicle(NOBODY.format(fleet=z.fleet_name), fleet=z.fleet_name)


async def planners(z: zmav.Client) -> list[str]:
    """The names of all planners, in charge or standing by."""
    key = keys.ALIVE.key(z.fleet_name, "*", role="planner", sys=0, autopilot="*", uid="-", instance="*")
    tokens = await asyncio.to_thread(find_tokens, z.session, key, LOOK)
    return sorted({keys.match(token)[1]["vehicle"] for token in tokens})


async def _status(z: zmav.Client, name: str) -> dict[str, Any] | ZmavError | None:
    """What one of them says of itself, or why it does not; None: no answer."""
    key = keys.SWARM.key(z.fleet_name, name, verb="status")
    answers = await z.ask(key, wire.encode(wire.Order()), ANSWER, keys.SWARM)
    for answer in answers:
        if isinstance(answer, ZmavError):
            return answer
        with contextlib.suppress(BadInput):
            return wire.decode(answer.payload, wire.Outcome, f"status of {name}").result
    return None


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
