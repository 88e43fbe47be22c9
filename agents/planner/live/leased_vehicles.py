"""The vehicles of one goal under our leases, and the plans that they fly; watched, and planned again where need be."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

import msgspec

import zmav
from agents.planner.execute.conductor import Conductor
from agents.planner.execute.executor import Executor
from agents.planner.execute.flight import Flight, Outcome, Trouble
from agents.planner.live.accuracy import tight_of
from agents.planner.live.context import Context, UnderWay
from agents.planner.live.margins import TIGHT, PlanMargins
from agents.planner.live.plan import Margins, Planned
from agents.planner.live.publisher import StatusPublisher
from agents.planner.live.scenes import moving
from agents.planner.model.geometry import segment_clear, world_of
from agents.planner.model.problem import Floats, MovingObstacle
from zmav import wire
from zmav.errors import Refused, ZmavError
from zmav.waiting import alongside
from zmav.wire import Vector, swarm

LOOK = 0.5
"""s between two looks at how far it is and who comes near"""
CLOCK_PATIENCE = 60.0
"""s for the clocks to be known well enough"""
WHEELED = 1.0
"""m from its goal at which a rover has arrived: it cannot move sideways"""
WORSE = 0.4
"""m, and half of what it was: by so much more a vehicle's position may be off in flight before there is a new plan"""
TAKE = 60.0
"""s that leases of another, which is gone, may still be in force: a segment lasts so long"""
Again = Callable[[Trouble], Awaitable["Planned | None"]]


class GoalUnderWay(UnderWay, Protocol):
    """A goal that is being flown, as what flies it knows it."""

    entry: swarm.GoalEntry
    stopping: str
    failure: ZmavError | None
    context: Context
    publisher: StatusPublisher

    @property
    def goes(self) -> bool: ...

    def text(self, text: str) -> None: ...

    def progress(self, share: float) -> None: ...

    def place(self, name: str) -> Vector: ...


class LeasedVehicles(Executor):
    """``async with LeasedVehicles(goal)``: takes each vehicle's lease; raises :class:`NotHolder` where it gets none."""

    def __init__(self, goal: GoalUnderWay) -> None:
        self._goal = goal
        super().__init__(
            goal.context.z,
            goal.vehicles,
            holder=goal.context.settings.name,
            say=self._tell,
            replan=self._plan_again,
            clock=goal.context.clocks.clock,
            offsets=goal.context.clocks.of(goal.vehicles),
            followings=goal.context.fleet.followings_of(goal.vehicles),
            taking=TAKE,
            waits=lambda why: goal.text(f"waits for a lease: {why}"),
            homes=goal.context.homes.keeper,
        )
        self._again: Again | None = None
        self._planned: Planned | None = None
        self._share, self._words = (0.0, 1.0), ""
        self._torn = False
        self._errors: dict[str, float] = {}
        """m that each one's position was taken to be off when what is flown was planned"""
        self.gone = set[str]()
        """who of those that flew the last plan does not fly it any more"""

    def vehicle(self, name: str) -> zmav.Vehicle:
        """Under our lease."""
        return self.commands[name].vehicle

    @property
    def paused(self) -> bool:
        """Everybody rests on the way, until it goes on."""
        return self.phase == "paused"

    @property
    def now(self) -> float:
        """Our UTC, by which everything is flown."""
        return self.clock.now()

    async def margins(self) -> Margins:
        """m by which plans should widen radii, and the share of their speed that vehicles may have with that; best
        first, by how well the clocks are known now.

        Waits for the clocks; raises :class:`~zmav.errors.Refused` where they stay too bad.
        """
        deadline = time.monotonic() + CLOCK_PATIENCE
        while True:
            try:
                return self._margins.best_first()
            except Refused as e:
                if time.monotonic() > deadline:
                    raise
                self._goal.text(f"waits: {e.message}")
            await asyncio.sleep(LOOK)

    # Flying.

    async def fly(self, planned: Planned, share: tuple[float, float], again: Again | None = None) -> Outcome:
        """Fly a plan to its end; ``again`` makes another where this one cannot be. ``share``: of the goal's progress.

        Raises :class:`~zmav.errors.Refused` where it cannot even begin.
        """
        goal = self._goal
        self._again, self._share, self.gone, self._words = again, share, set(), goal.entry.text
        if goal.goes and not self._torn:  # a pause may have ended while nothing was flown
            self.resume()
        else:
            self.pause()
        async with alongside(self._watch()) as (watching,):
            watching.add_done_callback(self._unwatched)
            try:
                return await self.run(self._flight(planned))
            finally:
                self._planned = None

    async def follow(self, conductor: Conductor, goes: Callable[[], bool]) -> str:
        """Fly what the conductor's source has for as long as it ``goes()``; why it was ended before, or nothing."""
        self._words = self._goal.entry.text
        return await super().follow(conductor, goes)

    def resume(self) -> None:
        if not self._torn:
            super().resume()

    def refresh(self) -> None:
        """Others are committed to something new."""
        self.avoid(self.movers(self.now))

    def world_changed(self) -> None:
        """Where something is in anybody's way all come to rest as soon as they can, and a new plan is made."""
        planned, context = self._planned, self._goal.context
        if planned is None:
            return
        pieces = context.world.pieces(time.time())
        told = msgspec.structs.replace(planned.scene, obstacles=list(pieces.obstacles), geofence=pieces.geofence)
        world = world_of(told)

        def clear(p: Floats, q: Floats, radius: float) -> bool:
            return bool(segment_clear(world, p, q, radius))

        self.obstructed(clear, "an obstacle or the fence")

    @property
    def tracking(self) -> float:
        """How far a vehicle may be off its way for the margin that we plan with, m."""
        return self._margins.tracking

    @property
    def _margins(self) -> PlanMargins:
        offsets = {name: command.offset for name, command in self.commands.items()}
        return PlanMargins(self._goal.context, self._goal.vehicles, offsets)

    def _flight(self, planned: Planned) -> Flight:
        """As the executor wants it; from now on it is what is watched and told of."""
        goal = self._goal
        vehicles = {vehicle.id: vehicle for vehicle in planned.scene.vehicles}
        self._planned = planned
        self._errors = {name: goal.context.fleet.accuracies.error(name) for name in vehicles}
        most = self.tracking
        tracking = min(most, most + planned.margin - self._margins.needed(most))
        goal.publisher.plan(goal.entry.id, time.time(), planned.motions, planned.clearance)
        return Flight(
            motions=planned.motions,
            radius={name: vehicle.radius - planned.margin for name, vehicle in vehicles.items()},
            accel={name: vehicle.amax for name, vehicle in vehicles.items()},
            downwash=planned.scene.downwash,
            margin=planned.margin,
            tracking=max(most / TIGHT, tracking),
            movers=self.movers(self.now),
            tolerance=max(Flight.tolerance, goal.context.settings.tracking, most),
            tolerances={name: WHEELED for name, vehicle in vehicles.items() if vehicle.type == "rover"},
        )

    async def _plan_again(self, trouble: Trouble) -> Flight | None:
        """The executor asks: everybody that goes on rests."""
        goal = self._goal
        self.gone |= set(trouble.gone)
        if self._again is None or goal.stopping:
            return None
        goal.context.say("replan", "notice", f"{goal.entry.id}: planned again: {trouble.reason}", goal=goal.entry.id)
        try:
            planned = await self._again(trouble)
        except ZmavError as e:
            goal.failure = e
            return None
        if planned is None or self._again is None:  # the watch failed meanwhile
            return None
        return self._flight(planned)

    def movers(self, now: float) -> list[MovingObstacle]:
        """Anyone who is not in this plan and nobody else's, on our UTC."""
        goal, context = self._goal, self._goal.context
        kin = context.committed(goal.entry.id)
        taken = context.airspace.vehicles({goal.entry.id}) | {mover.id for mover in kin}
        movers = moving(goal.vehicles, context.fleet.all(), context.world.pieces(time.time()), taken)
        return kin + [mover.later(now) for mover in movers]

    async def _watch(self) -> None:
        """While a plan is flown: its progress, who comes near, whether we hear enough of the fleet."""
        goal = self._goal
        while True:
            await asyncio.sleep(LOOK)
            begin, end = self._share
            goal.progress(begin + (end - begin) * self.progress)
            hearing = goal.context.fleet.hearing()
            torn = not hearing.may_move(goal.vehicles)
            if torn and not self._torn:
                goal.context.say("partition", "warning", f"{goal.entry.id}: {hearing.words()}", goal=goal.entry.id)
                self.pause()
            elif self._torn and not torn:
                goal.context.say(
                    "partition", "notice", f"{goal.entry.id}: enough of the fleet is heard again", goal=goal.entry.id
                )
                if goal.goes:
                    super().resume()
            self._torn = torn
            self._look_at_positions()
            self.refresh()

    def _unwatched(self, watching: asyncio.Task[None]) -> None:
        """Nothing is flown that is not watched: where the watch fails all come to rest, and there is no new plan."""
        if not watching.cancelled() and (fault := watching.exception()) is not None:
            self._again = None
            self.halt(f"the planner's own fault: {fault!r}")

    def _look_at_positions(self) -> None:
        """Who knows much less well where it is than when the plan was made has too little room in it."""
        if self.phase != "flying" or tight_of(self._goal.entry.goal):
            return
        for name, before in self._errors.items():
            error = self._goal.context.fleet.accuracies.error(name)
            if error > before + max(WORSE, 0.5 * before):
                self.halt(f"{name} knows its position to ±{error:.1f} m, not to ±{before:.1f} m any more")
                return

    def _tell(self, kind: str, severity: wire.Severity, text: str, detail: dict[str, Any]) -> None:
        goal = self._goal
        goal.text(text if severity in ("warning", "error") else self._words)
        goal.context.say(kind, severity, f"{goal.entry.id}: {text}", goal=goal.entry.id, **detail)
