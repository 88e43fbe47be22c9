"""An order to several vehicles, seen through: the one rule of ``zmav do``, of the gateway and of its page.

A disarmed vehicle is not told to return or to land. Several are brought home by the planner in charge, in a plan in
which nobody meets; where none answers at once, or it refuses, each returns by itself. An order has ended when it came
true: a vehicle that is to return is done when it has landed and disarmed.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, Literal

import msgspec

from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import Refused, TimedOut, ZmavError
from zmav.vehicle import Vehicle
from zmav.waiting import within
from zmav.wire import swarm

LOOK, ANSWER = 0.8, 1.0
"""s for a planner to be heard of, which says several times a second that it is in charge, and for its answer"""
BEGIN = 3.0
"""s from its answer until the plan is flown; meanwhile it has its vehicles come to rest"""
SILENCE = 15.0
"""s without a word of the planner after which it is dead: a standby takes over sooner"""
BACK = ("rtl", "land")
"""orders that are for what is in the air"""
SURFACE = ("rover", "boat")
ENDED = ("done", "failed", "cancelled")


class Told(msgspec.Struct, kw_only=True):
    """How it stands with one vehicle."""

    vehicle: str
    fleet: str
    status: Literal["running", "done", "left_out", "failed"] = "running"
    text: str = ""
    """in words: what it does, how it ended, or why not"""
    result: dict[str, Any] = {}
    error: str = ""
    """the error's code, where it failed"""


class FleetOrder:
    """``await FleetOrder(z, vehicles, verb, args).run()``; ``told`` and ``notes`` say at any time how it stands.

    ``on_change`` is called on the event loop with a note, or with what has just ended; ``progress`` gives what is to be
    told how far a vehicle's order is. Nothing is raised: what a
    vehicle refuses stands in ``told``.
    """

    def __init__(
        self, z: Client, vehicles: Sequence[Vehicle], verb: str, args: wire.Order,
        on_change: Callable[[str | Told], None] = lambda news: None,
        progress: Callable[[Vehicle], Callable[[dict[str, Any]], None] | None] = lambda vehicle: None,
    ) -> None:  # fmt: skip
        self._z, self._vehicles, self.verb, self._args, self._say = z, list(vehicles), verb, args, on_change
        self._progress = progress
        self.told = {(v.fleet, v.name): Told(vehicle=v.name, fleet=v.fleet) for v in vehicles}
        self.notes: list[str] = []
        self._dropping: asyncio.Task[None] | None = None

    async def run(self) -> list[Told]:
        """See it through; the vehicles see to themselves where nobody waits any longer."""
        goes = list[Vehicle]()
        for vehicle in self._vehicles:
            if why := _left_out(vehicle, self.verb, alone=len(self._vehicles) == 1):
                self._end(vehicle, "left_out", f"left out: {why}")
            else:
                goes.append(vehicle)
        fleets: dict[str, list[Vehicle]] = defaultdict(list)
        for vehicle in goes:
            fleets[vehicle.fleet].append(vehicle)
        together = self._return if self.verb == "rtl" else self._each
        await asyncio.gather(*(together(vehicles) for vehicles in fleets.values()))
        return list(self.told.values())

    def _runs(self, vehicle: Vehicle) -> bool:
        return self.told[vehicle.fleet, vehicle.name].status == "running"

    # Each by itself.

    async def _each(self, vehicles: list[Vehicle]) -> None:
        await asyncio.gather(*map(self._one, vehicles))

    async def _one(self, vehicle: Vehicle) -> None:
        try:
            result = await vehicle.order(self.verb, self._args, self._progress(vehicle))
        except ZmavError as e:
            self._end(vehicle, "failed", e.message, error=e.code)
            return
        self._end(vehicle, "done", _ended(self.verb, vehicle, result), result=result)

    def _end(self, vehicle: Vehicle, status: Literal["done", "left_out", "failed"], text: str, **more: Any) -> None:
        place = (vehicle.fleet, vehicle.name)
        self.told[place] = told = Told(vehicle=vehicle.name, fleet=vehicle.fleet, status=status, text=text, **more)
        self._say(told)

    def _note(self, text: str) -> None:
        self.notes.append(text)
        self._say(text)

    # Home, by a plan.

    async def _return(self, vehicles: list[Vehicle]) -> None:
        """By the planner where there is one and more than one flies; else each by the autopilot's own RTL."""
        if len(vehicles) > 1:
            try:
                await self._return_planned(vehicles)
                return
            except ZmavError as e:
                self._note(f"no planned return ({e.message}): each returns by itself, and nobody keeps them apart")
        await self._each(vehicles)

    async def _return_planned(self, vehicles: list[Vehicle]) -> None:
        """Raises :class:`ZmavError` where nobody flies it in time; from then on its end is told."""
        fleet, names = vehicles[0].fleet, [vehicle.name for vehicle in vehicles]
        planner = await self._planner(fleet)
        key = keys.FLEET.key(fleet, topic="goal")
        async with self._z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), swarm.Book, key)) as books:
            submit = swarm.Submit(goal=swarm.Return(vehicles=names), id=uuid.uuid4().hex)
            goal = str((await self._ask(fleet, planner, "submit", submit)).get("goal"))
            deadline, begun = time.monotonic() + BEGIN, False
            while True:
                try:
                    book = await within(deadline - time.monotonic(), books.get())
                except asyncio.TimeoutError:
                    if not begun:
                        self._dropping = asyncio.create_task(self._drop(fleet, planner, goal))
                        late = f"{planner} has not begun within {BEGIN:.0f} s"
                        raise TimedOut(late, planner=planner, goal=goal) from None
                    self._over(vehicles, f"planner {planner} is silent")
                    return
                entry = next((entry for entry in book.goals if entry.id == goal), None)
                if entry is None:
                    continue
                if not begun and entry.state in ("failed", "cancelled"):
                    raise Refused(f"{planner}: {entry.text}", planner=planner, goal=goal)
                if not begun and entry.state in ("flying", "done"):
                    begun = True
                    self._note(f"planner {planner} brings {', '.join(names)} home ({goal})")
                if begun:
                    deadline = time.monotonic() + SILENCE
                    self._watch(vehicles)
                if entry.state in ENDED:
                    self._over(vehicles, "" if entry.state == "done" else f"{goal} {entry.state}: {entry.text}")
                    return

    def _watch(self, vehicles: list[Vehicle]) -> None:
        """Who has landed has ended, whatever the others do."""
        for vehicle in vehicles:
            state = vehicle.last_state
            if state is not None and state.armed is False and self._runs(vehicle):
                result = {"mode": state.mode, "armed": False}
                self._end(vehicle, "done", _ended("rtl", vehicle, result), result=result)

    def _over(self, vehicles: list[Vehicle], trouble: str) -> None:
        """The plan has come to its end; ``trouble``: not as it should."""
        self._watch(vehicles)
        for vehicle in vehicles:
            if not self._runs(vehicle):
                continue
            if trouble:
                text = f"{trouble}; it is still armed: give it rtl alone, and it returns by itself"
                self._end(vehicle, "failed", text, error="refused")
            else:
                state = vehicle.last_state
                result = {"mode": state.mode if state else None, "armed": True}
                self._end(vehicle, "done", _ended("rtl", vehicle, result), result=result)

    async def _planner(self, fleet: str) -> str:
        """Who is in charge there, by its own word."""
        key = keys.FLEET.key(fleet, topic="charge")
        async with self._z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), swarm.Charge, key)) as told:
            try:
                return keys.check_name((await within(LOOK, told.get())).planner, "planner")
            except asyncio.TimeoutError:
                raise TimedOut(f"no planner is in charge of fleet {fleet}", fleet=fleet) from None

    async def _ask(self, fleet: str, planner: str, verb: str, order: wire.Order) -> dict[str, Any]:
        key = keys.SWARM.key(fleet, planner, verb=verb)
        for answer in await self._z.ask(key, wire.encode(order), ANSWER, keys.SWARM, lambda _: True):
            if isinstance(answer, Answer):
                return wire.decode(answer.payload, wire.Outcome, f"reply to {key}").result
            raise answer
        raise TimedOut(f"planner {planner} does not answer", planner=planner)

    async def _drop(self, fleet: str, planner: str, goal: str) -> None:
        """Who has not begun is not to begin any more; a plan that does nevertheless waits for vehicles at rest."""
        try:
            await self._ask(fleet, planner, "cancel", swarm.GoalId(goal=goal, id=uuid.uuid4().hex))
        except ZmavError as e:
            self._note(f"{goal} of planner {planner} is not known to be cancelled: {e.message}")


def _left_out(vehicle: Vehicle, verb: str, *, alone: bool) -> str:
    """Why the order is not for this vehicle; empty: it is, or what it said last is too old to tell."""
    if keys.is_replay(vehicle.fleet):
        return "it is a recording"
    try:
        state = vehicle.state
    except ZmavError:
        return ""
    if verb in BACK and state.connected and state.armed is False:
        return "it is disarmed"
    return f"a {state.kind} does not land" if verb == "land" and state.kind in SURFACE and not alone else ""


def _ended(verb: str, vehicle: Vehicle, result: dict[str, Any]) -> str:
    if verb not in BACK:
        return "done"
    if not result.get("armed"):
        return "done: landed and disarmed"
    state = vehicle.last_state
    circles = state is not None and state.kind not in SURFACE
    return f"in {result.get('mode') or verb.upper()}, {'circling' if circles else 'on its way home'}; it stays armed"
