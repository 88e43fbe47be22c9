"""An order to several vehicles, seen through: the one rule of ``zmav do``, of the gateway and of its page.

A disarmed vehicle is not told to return or to land. Several are brought home by the planner in charge, in a plan in
which nobody meets: they hold from the beginning, while it is asked and plans. Where it cannot be asked, refuses, fails
on the way or falls silent, each returns by itself, as does from the beginning whom no plan can bring home. An order has
ended when it came true: a copter that is to return is done when it has landed and disarmed, a plane when it circles at
home, a rover when it stands there.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, Literal

import msgspec
import zenoh

from zmav import keys, wire
from zmav.client import Client
from zmav.errors import NoSuchVehicle, Refused, TimedOut, ZmavError
from zmav.vehicle import Vehicle
from zmav.waiting import cancelled, within
from zmav.wire import swarm
from zmav.wire.orders import DISARMED

BEGIN = 1.5
"""s from its answer until its book has the goal. A book follows each change at once, and the next a second later: a
planner whose book lacks it so long is stuck or cut off, and it is not known whether it will fly
"""
SILENCE = 5.0
"""s without its book, which comes once a second: five in a row are hardly lost, and a standby takes over after three"""
BEAT = 0.4
"""s in which whoever is in charge says so at least once: three times a second"""
CHIEF_LOOK, CHIEF_ANSWER, CHIEF_END = 4.0, 3.0, 30.0
"""s for a planner to be heard of (a standby takes over after three), for an answer of it, and for the end of what it
was asked: a preview is planned as it would be flown
"""
BACK = ("rtl", "land")
"""orders that are for what is in the air"""
SURFACE = ("rover", "boat")
STAYING = (*SURFACE, "plane")
"""kinds that do not land at home: they stand or circle there, armed"""
Status = Literal["running", "returning", "done", "left_out", "failed"]
UNDER_WAY = ("running", "returning")
TAKEN = ("revoked", "preempted", "pilot")
"""how the planner's lease ends where somebody has ordered otherwise since"""


class VehicleProgress(msgspec.Struct, kw_only=True):
    """How it stands with one vehicle."""

    vehicle: str
    fleet: str
    status: Status = "running"
    """returning: it is on its way home"""
    text: str = ""
    """in words: what it does, how it ended, or why not"""
    result: dict[str, Any] = {}
    error: str = ""
    """the error's code, where it failed"""


class FleetOrder:
    """``await FleetOrder(z, vehicles, verb, args).run()``; ``told`` and ``notes`` say at any time how it stands.

    ``on_change`` is called on the event loop with a note, or with what has just ended; ``progress`` gives what is to be
    told how far a vehicle's order is. Nothing is raised: what a vehicle refuses stands in ``told``.
    """

    look = 0.8
    answer = 1.0
    """s for a planner to be heard of, which says several times a second that it is in charge, and for its answer"""
    plan = 10.0
    """s from its answer until the plan is flown. Its vehicles hold meanwhile: they come to rest in some three, a plan
    is mostly made in as many, and who is low on battery cannot wait for a hard one
    """

    def __init__(
        self,
        z: Client,
        vehicles: Sequence[Vehicle],
        verb: str,
        args: wire.Order,
        on_change: Callable[[str | VehicleProgress], None] = lambda news: None,
        progress: Callable[[Vehicle], Callable[[dict[str, Any]], None] | None] = lambda vehicle: None,
    ) -> None:
        self._z, self._vehicles, self.verb, self._args, self._say = z, list(vehicles), verb, args, on_change
        self._progress = progress
        self.told = {(v.fleet, v.name): VehicleProgress(vehicle=v.name, fleet=v.fleet) for v in vehicles}
        self.notes: list[str] = []
        self._held: dict[tuple[str, str], float] = {}
        """when each was told to hold and did, by its own clock: what takes it later is somebody's later order"""
        self._planners: dict[str, str] = {}
        """by fleet: who was asked"""
        self._dropping: list[asyncio.Task[None]] = []

    async def run(self) -> list[VehicleProgress]:
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
        await asyncio.gather(*self._dropping)  # who asked may end now, and with it what was not sent yet
        return list(self.told.values())

    def _runs(self, vehicle: Vehicle) -> bool:
        return self.told[vehicle.fleet, vehicle.name].status in UNDER_WAY

    # Each by itself.

    async def _each(self, vehicles: Sequence[Vehicle]) -> None:
        await asyncio.gather(*map(self._one, vehicles))

    async def _one(self, vehicle: Vehicle) -> None:
        tell = self._progress(vehicle)

        def report(news: dict[str, Any]) -> None:
            if news and self.verb == "rtl":
                self._returning(vehicle, "by itself")
            if tell is not None:
                tell(news)

        try:
            result = await vehicle.order(self.verb, self._args, report)
        except ZmavError as e:
            if e.detail.get("reason") == DISARMED:
                self._end(vehicle, "left_out", "left out: it is disarmed")
            else:
                self._end(vehicle, "failed", e.message, error=e.code)
            return
        self._end(vehicle, "done", _ended(self.verb, vehicle, result), result=result)

    def _returning(self, vehicle: Vehicle, how: str) -> None:
        self._set(vehicle, "returning", f"on its way home, {how}")

    def _end(self, vehicle: Vehicle, status: Literal["done", "left_out", "failed"], text: str, **more: Any) -> None:
        self._say(self._set(vehicle, status, text, **more))

    def _set(self, vehicle: Vehicle, status: Status, text: str, **more: Any) -> VehicleProgress:
        told = VehicleProgress(vehicle=vehicle.name, fleet=vehicle.fleet, status=status, text=text, **more)
        self.told[vehicle.fleet, vehicle.name] = told
        return told

    def _note(self, text: str) -> None:
        self.notes.append(text)
        self._say(text)

    # Home, by a plan.

    async def _return(self, vehicles: list[Vehicle]) -> None:
        """By the planner whom it can bring home, where there is more than one; the others by the autopilot's RTL."""
        unfit = {vehicle.name: why for vehicle in vehicles if (why := _unfit(vehicle))}
        fit = [vehicle for vehicle in vehicles if vehicle.name not in unfit]
        if len(fit) < 2:
            await self._each(vehicles)
            return
        for name, why in unfit.items():
            self._note(f"{name} returns by itself: {why}")
        alone = [vehicle for vehicle in vehicles if vehicle.name in unfit]
        await asyncio.gather(self._each(alone), self._return_together(fit))

    async def _return_together(self, vehicles: list[Vehicle]) -> None:
        """Who flies somewhere is stopped before anybody is asked, and returns by itself where no plan leads it."""
        stops = [asyncio.create_task(self._stop(vehicle)) for vehicle in vehicles]
        try:
            await self._return_planned(vehicles, stops)
            return
        except ZmavError as e:
            self._note(f"no planned return ({e.message}): each returns by itself, and nobody keeps them apart")
        finally:
            await cancelled(*stops)
        await self._each([vehicle for vehicle in vehicles if self._runs(vehicle) and not self._taken(vehicle)])

    async def _stop(self, vehicle: Vehicle) -> None:
        try:
            await vehicle.hold()
        except ZmavError as e:
            self._note(f"{vehicle.name} was told to hold until it is brought home, and did not: {e.message}")
        else:
            state = vehicle.last_state
            self._held[vehicle.fleet, vehicle.name] = state.t if state else time.time()

    def _taken(self, vehicle: Vehicle) -> bool:
        """Somebody has ordered otherwise while the planner had it: that is the later word, and is not overruled."""
        state, held = vehicle.last_state, self._held.get((vehicle.fleet, vehicle.name))
        end = state.lease_end if state is not None else None
        if held is None or end is None or end.t <= held or end.reason not in TAKEN:
            return False
        if end.holder != self._planners.get(vehicle.fleet):
            return False  # another's lease, which our own hold has ended
        self._end(vehicle, "failed", f"not brought home: {end.text}", error="refused")
        return True

    async def _return_planned(self, vehicles: list[Vehicle], stops: Sequence[asyncio.Task[None]]) -> None:
        """Raises :class:`ZmavError` where nobody flies it in time or to its end; who has landed by then is told of."""
        fleet, names = vehicles[0].fleet, [vehicle.name for vehicle in vehicles]
        found = await planner_in_charge(self._z, fleet, self.look)  # by its own word
        if found is None:
            raise TimedOut(f"no planner is in charge of fleet {fleet}", fleet=fleet)
        planner = self._planners[fleet] = found[1]
        key = keys.FLEET.key(fleet, topic="goal")
        async with self._z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), swarm.Book, key)) as books:
            submit = swarm.Submit(goal=swarm.Return(vehicles=names), id=uuid.uuid4().hex)
            goal = str((await self._ask(fleet, planner, "submit", submit)).get("goal"))
            began = heard = time.monotonic()
            state: swarm.GoalState | None = None
            begun = False
            while True:
                silent = heard + (SILENCE if state else BEGIN)
                until = min(silent, began + self.plan) if state and not begun else silent
                try:
                    book = await within(until - time.monotonic(), books.get())
                except asyncio.TimeoutError:
                    self._watch(vehicles)
                    self._dropping.append(asyncio.create_task(self._drop(fleet, planner, goal)))
                    raise TimedOut(self._late(planner, state, until == silent), planner=planner, goal=goal) from None
                entry = next((entry for entry in book.goals if entry.id == goal), None)
                if entry is None:
                    continue
                heard, state = time.monotonic(), entry.state
                self._watch(vehicles)
                if state == "flying" and not begun:
                    begun = True
                    await cancelled(*stops)  # one that comes only now would stop what is flown
                    self._note(f"planner {planner} brings {', '.join(names)} home ({goal})")
                    for vehicle in filter(self._runs, vehicles):
                        self._returning(vehicle, f"by a plan of {planner}")
                elif state == "failed":
                    raise Refused(f"{planner}: {entry.text}", planner=planner, goal=goal)
                elif state in ("done", "cancelled"):
                    trouble = f"{goal} was cancelled: {entry.text}" if state == "cancelled" else ""
                    await asyncio.gather(*(self._over(vehicle, trouble) for vehicle in filter(self._runs, vehicles)))
                    return

    def _watch(self, vehicles: list[Vehicle]) -> None:
        """Who has landed has ended, whatever the others do."""
        for vehicle in vehicles:
            state = vehicle.last_state
            if state is not None and state.armed is False and self._runs(vehicle):
                result = {"mode": state.mode, "armed": False}
                self._end(vehicle, "done", _ended("rtl", vehicle, result), result=result)

    async def _over(self, vehicle: Vehicle, trouble: str) -> None:
        """The plan has come to its end; ``trouble``: somebody ended it, whose word that was."""
        state = vehicle.last_state
        if not trouble and (state is None or state.kind not in STAYING):
            with contextlib.suppress(TimedOut):  # its state comes a little after its landing
                state = await vehicle.wait_until(lambda s: s.armed is False, SILENCE)
        self._watch([vehicle])
        if not self._runs(vehicle):
            return
        if trouble or state is None or state.kind not in STAYING:
            text = f"{trouble or 'the plan is over'}; it is still armed: give it rtl alone, and it returns by itself"
            self._end(vehicle, "failed", text, error="refused")
        else:
            result: dict[str, Any] = {"mode": state.mode, "armed": True}
            self._end(vehicle, "done", _home(vehicle, result), result=result)

    async def _ask(self, fleet: str, planner: str, verb: str, order: wire.Order) -> dict[str, Any]:
        ends = time.monotonic() + self.answer
        return await order_planner(self._z, fleet, planner, verb, order, answer_s=self.answer, silent=1, ends=ends)

    def _late(self, planner: str, last: swarm.GoalState | None, silent: bool) -> str:
        if last is None:
            return f"{planner} has not begun within {BEGIN:g} s"
        return f"planner {planner} is silent" if silent else f"{planner} has no plan after {self.plan:.0f} s"

    async def _drop(self, fleet: str, planner: str, goal: str) -> None:
        """What is late is not to begin any more; a plan that does nevertheless waits for vehicles at rest."""
        try:
            await self._ask(fleet, planner, "cancel", swarm.GoalId(goal=goal, id=uuid.uuid4().hex))
        except ZmavError as e:
            self._note(f"{goal} of planner {planner} is not known to be cancelled: {e.message}")


async def planner_in_charge(z: Client, fleet: str, timeout: float, rivals: float = 0.0) -> tuple[str, str] | None:
    """Fleet and name of the planner in charge, by its own word; None: none is heard within ``timeout`` s. ``fleet`` may
    be ``*``. Two may say so for seconds, as when a network has been torn: of those that are heard within ``rivals`` s
    after the first it is the highest by term and instance.
    """

    def convert(sample: zenoh.Sample) -> tuple[int, str, str, str]:
        key = str(sample.key_expr)
        charge = wire.decode(sample.payload.to_bytes(), swarm.Charge, key)
        fleet, name = keys.match(key)[1]["fleet"], keys.check_name(charge.planner, "planner")
        return charge.term, charge.instance, fleet, name

    highest: tuple[int, str, str, str] | None = None
    until = time.monotonic() + timeout
    async with z.subscribe(keys.FLEET.key(fleet, topic="charge"), convert) as told:
        with contextlib.suppress(asyncio.TimeoutError):
            while (left := until - time.monotonic()) > 0.0:
                heard = await within(left, told.get())
                if highest is None:
                    until = time.monotonic() + rivals
                highest = heard if highest is None else max(highest, heard)
    return None if highest is None else highest[2:]


async def order_planner(
    z: Client, fleet: str, planner: str, verb: str, order: wire.Order, *, answer_s: float, silent: int, ends: float
) -> dict[str, Any]:
    """Ask a planner until it says how an order with an id ended; raises its typed error, or :class:`TimedOut` where
    ``silent`` questions in a row got no answer within ``answer_s`` s, or no end was told by ``ends`` (monotonic s).
    """
    key, payload, unanswered = keys.SWARM.key(fleet, planner, verb=verb), wire.encode_request(order), 0
    text = f"planner {planner} does not answer on {key}"
    while unanswered < silent and (left := ends - time.monotonic()) > 0.0:
        answers = await z.ask(key, payload, min(answer_s, left), keys.SWARM)
        if not answers:
            unanswered += 1
            continue
        unanswered, text = 0, f"planner {planner} does not say how {verb} ended"
        if isinstance(answers[0], ZmavError):
            raise answers[0]
        outcome = wire.decode(answers[0].payload, wire.Outcome, f"reply to {key}")
        if outcome.status == "done":
            return outcome.result
    raise TimedOut(text, planner=planner)


async def order_chief(z: Client, verb: str, *orders: wire.Order) -> dict[str, Any]:
    """Ask the planner in charge of the client's fleet, once it is heard of for at most half a minute, one order after
    another: what came of the last. Raises its typed error, or :class:`NoSuchVehicle` where none is in charge.
    """
    found, result = await planner_in_charge(z, z.fleet_name, CHIEF_LOOK), dict[str, Any]()
    if found is None:
        text = f"no planner is in charge of fleet {z.fleet_name}: start one with 'zmav swarm planner'"
        raise NoSuchVehicle(text, fleet=z.fleet_name)
    ends = time.monotonic() + CHIEF_END
    for order in orders:
        result = await order_planner(z, *found, verb, order, answer_s=CHIEF_ANSWER, silent=2, ends=ends)
    return result


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


def _unfit(vehicle: Vehicle) -> str:
    """Why no plan can bring it home; empty: one can."""
    try:
        state = vehicle.state
    except ZmavError:
        return "it is not heard"
    if not state.connected:
        return "its autopilot is not heard"
    if state.pilot:
        return state.pilot
    if state.landed and state.kind not in SURFACE:
        return "it stands on the ground"
    return "" if state.local is not None else "it does not say where it is in the fleet's frame"


def _ended(verb: str, vehicle: Vehicle, result: dict[str, Any]) -> str:
    if verb not in BACK:
        return "done"
    if not result.get("armed"):
        return "done: landed and disarmed"
    if "away" in result:
        return _home(vehicle, result)
    return f"in {result.get('mode')}: its autopilot does not say where home is; it stays armed"


def _home(vehicle: Vehicle, result: dict[str, Any]) -> str:
    state = vehicle.last_state
    kind = "" if state is None else state.kind or ""
    stays = "standing" if kind in SURFACE else "hovering" if kind == "copter" else "circling"
    return f"done: home, {stays} in {result.get('mode')}; it stays armed"
