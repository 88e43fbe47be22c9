"""One goal, from its turn to its end: what it comes down to, planned and flown step by step."""

from __future__ import annotations

import asyncio
import contextlib
import time

import numpy as np

from agents.planner.execute.flight import Outcome, Trouble
from agents.planner.goals.steps import (
    FleetView,
    Fly,
    Loiter,
    Orders,
    PlanTo,
    Step,
    Stop,
    Track,
    for_the_rest,
    without,
)
from agents.planner.live import resting
from agents.planner.live.accuracy import tight_of
from agents.planner.live.cameras import Cameras, check_cameras
from agents.planner.live.context import Context
from agents.planner.live.frames import enu, ned, vector
from agents.planner.live.leased_vehicles import Again, LeasedVehicles
from agents.planner.live.ledger import ENDED
from agents.planner.live.orders import carry_out, halt, loiter
from agents.planner.live.plan import MOST_APART, SOON, Margins, Planned, Planner
from agents.planner.live.publisher import StatusPublisher
from agents.planner.live.relief import bring_home, check_batteries, left_over, low_of, relieve
from agents.planner.live.reserved import tube
from agents.planner.live.resting import COMING
from agents.planner.live.scenes import moved
from agents.planner.live.tracking import Blocked, Tracking
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Motion, MovingObstacle
from zmav.errors import Refused, Stale, TimedOut, ZmavError
from zmav.waiting import cancelled
from zmav.wire import Vector, swarm

SETTLE = 90.0
"""s that vehicles may take to come to rest before a goal begins: a segment lasts a minute at most"""
LASTING = 60.0
"""s that a segment may last"""
MOST_REFUSED = 3
"""plans that nobody can begin to fly, after which there is no other"""


class Run:
    """Begun by its making. Lives on the event loop; whatever happens ends in the book, in words."""

    def __init__(self, context: Context, publisher: StatusPublisher, entry: swarm.GoalEntry) -> None:
        self.context, self.publisher, self.entry = context, publisher, entry
        self.vehicles = tuple(entry.goal.vehicles)
        self.leader = entry.goal.leader if isinstance(entry.goal, swarm.Follow) else None
        self.planner = Planner(context, entry.id, context.solver)
        self.tracks = False
        """it follows its leader just now"""
        self.stopping = ""
        """why it is to end; empty: it goes on"""
        self.low = dict[str, str]()
        """who runs low, for which it is to end, and why in words"""
        self._begun = False
        """its vehicles may fly it by what is left in their batteries"""
        self._lanes = dict[str, Motion]()
        """what is left of a search, by vehicle"""
        self.failure: ZmavError | None = None
        """why there was no other plan"""
        self._goes = asyncio.Event()
        if entry.state != "paused":
            self._goes.set()
        self.flying: LeasedVehicles | Tracking | None = None
        self._task = asyncio.create_task(self._live())

    @property
    def done(self) -> bool:
        return self._task.done()

    @property
    def goes(self) -> bool:
        """It is not paused."""
        return self._goes.is_set()

    # What others tell it.

    def stop(self, why: str) -> None:
        """Come to rest along what is flown, and end."""
        if self.stopping:
            return
        self.stopping = why or "stopped"
        self._goes.set()  # a new plan that waits for the end of a pause is not made any more
        if self.flying is not None:
            self.flying.halt(self.stopping)
        else:
            self._task.cancel()

    def look_at_batteries(self) -> None:
        """Who would land with less than its reserve goes home: everybody comes to rest first."""
        if self._begun and not self.stopping and (low := low_of(self.context, self.entry.goal, self.vehicles)):
            self.low = low
            self.stop("; ".join(low.values()))

    def pause(self) -> None:
        if not self.stopping:
            self._goes.clear()
        if self.flying is not None:
            self.flying.pause()

    def resume(self) -> None:
        self._goes.set()
        if self.flying is not None:
            self.flying.resume()

    def committed(self) -> list[MovingObstacle]:
        """What its vehicles are sure to fly, on our UTC; nothing while they rest."""
        return self.flying.committed if self.flying is not None else []

    def refresh(self) -> None:
        """The one that is followed, or who follows, is committed to something new."""
        if self.flying is not None:
            self.flying.refresh()

    def world_changed(self) -> None:
        """There are other obstacles: what is being flown is looked at again."""
        if self.flying is not None:
            self.flying.world_changed()

    async def close(self) -> None:
        """End without a word in the book; anyone who still flies comes to rest along its way first."""
        self.stopping = self.stopping or "closed"
        await cancelled(self._task)

    # What it tells.

    def text(self, text: str) -> None:
        if self.entry.state not in ENDED and self.entry.text != text:
            self.entry.text = text
            self.context.untold.set()

    def progress(self, share: float) -> None:
        self.entry.progress = round(max(self.entry.progress, min(share, 1.0)), 3)

    # Its life.

    async def _live(self) -> None:
        entry, ledger = self.entry, self.context.ledger
        try:
            missing = await self._fly()
            text = f"the others are there; without {', '.join(missing)}" if missing else "done"
            ledger.end(entry, "failed" if missing else "done", text)
        except asyncio.CancelledError:
            if not self.stopping:
                raise
        except PlanError as e:
            ledger.end(entry, "failed", f"{e.kind}: {e.message}")
        except ZmavError as e:
            ledger.end(entry, "failed", str(e))
            if e.detail.get("reason") == "battery" and isinstance(entry.goal, swarm.Search) and entry.goal.lanes:
                bring_home(self.context, entry)
        except Exception as e:
            ledger.end(entry, "failed", f"the planner's own fault: {e!r}")
        finally:
            self._leave_room()
            self.publisher.plan_over(entry.id)
        if self.low and self.context.charge.in_charge and self.entry.state not in ENDED:
            relieve(self.context, entry, self.low, self._lanes)
        if self.stopping == "closed":
            return
        word = "failed: " if entry.state == "failed" else ""
        self.context.say("goal", "error" if word else "info", f"{entry.id}: {word}{entry.text}", goal=entry.id)
        self.context.wake()

    async def _fly(self) -> list[str]:
        """Gives the vehicles that did not come to the end."""
        self._state("planning", "waits until its vehicles rest")
        lost = await self._settled(patient=True)
        await self._goes.wait()
        view = self._view(lost=lost)
        steps = await self.planner.steps(self.entry.goal, view)
        self._go_without(lost)
        check_batteries(self.context, self.entry, self.vehicles, steps, self._view())
        self._begun = True
        self._lanes = next((dict(step.motions) for step in steps if isinstance(step, Fly)), {})
        async with LeasedVehicles(self) as leased:
            if silent := set(leased.left):  # no answer: they stay where they rest
                self._go_without(silent)
                lost |= silent
                self.context.say(
                    "lost", "warning", f"{self.entry.id}: goes on without {', '.join(sorted(silent))}: no answer"
                )
            await self._settled()  # from now on nobody else moves them
            await check_cameras(leased, steps)
            missing = await self._take_each(leased, steps, lost, (0.0, 1.0))
        return sorted(missing)

    async def _take_each(
        self, leased: LeasedVehicles, steps: list[Step], gone: set[str], share: tuple[float, float]
    ) -> set[str]:
        """Gives ``gone`` and who was lost on the way: the others go on to land, and to nothing else."""
        begin, each = share[0], (share[1] - share[0]) / max(len(steps), 1)
        for number, step in enumerate([for_the_rest(step, gone) for step in steps]):
            await self._goes.wait()
            self.text(step.text or type(step).__name__)
            part = (begin + number * each, begin + (number + 1) * each)
            missing = await self._take(leased, step, part, gone)
            self.check_stopped()
            self.progress(part[1])
            gone = gone | set(missing)
            self._go_without(gone)
            if missing and not all(isinstance(later, Orders) and later.lands for later in steps[number + 1 :]):
                break
        return gone

    def _go_without(self, lost: set[str]) -> None:
        self.vehicles = tuple(name for name in self.vehicles if name not in lost)

    async def _take(self, leased: LeasedVehicles, step: Step, share: tuple[float, float], gone: set[str]) -> list[str]:
        if isinstance(step, PlanTo):
            return await self._plan_and_fly(leased, step, share)
        if isinstance(step, Fly):
            async with Cameras(self, leased, step.pictures):
                return await self._fly_motions(leased, step, share)
        if isinstance(step, Orders):
            self._state("flying", step.text or "carries out orders")
            await carry_out(self, leased, step, gone)
        elif isinstance(step, Loiter):
            self._state("flying", step.text or "planes go to their circles")
            await loiter(self, leased, step)
        elif isinstance(step, Track):
            self._state("flying", step.text or "follows")
            return await self._follow(leased, step, share)
        else:
            assert isinstance(step, Stop)
            await halt(self, leased, step.vehicles)
        return []

    async def _plan_and_fly(self, leased: LeasedVehicles, step: PlanTo, share: tuple[float, float]) -> list[str]:
        """Plan from where they are, fly; what goes wrong on the way is planned again from where everybody rests."""
        self._state("planning", step.text or "plans")

        rest, flown, refused, made, missing = step, None, 0, 0, set[str]()

        async def again(trouble: Trouble) -> Planned | None:
            nonlocal rest, flown
            await self._goes.wait()
            rest = without(rest, set(trouble.gone))
            if not rest.vehicles or self.stopping:
                return None
            self._state("planning", f"planned again: {trouble.reason}")
            places = {name: ned(vector(place)) for name, place in trouble.places.items()}
            flown = await self._planned(leased, rest, moved(self._view(rest.vehicles), places, airborne=None))
            self._speak_for(flown)
            self._state("flying", step.text or "flies")
            return flown

        while True:
            flown = await self._planned(leased, rest, self._view(rest.vehicles))
            try:
                outcome = await self._flown(leased, flown, step.text, share, again)
            except Refused as e:  # nobody moves for it: a clock is known worse than before, or somebody drifted
                refused += 1
                if refused == MOST_REFUSED:
                    raise
                missing |= leased.gone
                self._go_without(missing)
                self.context.say("replan", "notice", f"{self.entry.id}: planned again: {e.message}", goal=self.entry.id)
                self._state("planning", f"planned again: {e.message}")
                await self._settled(rest.vehicles)
                continue
            if not outcome.done:
                self.check_stopped()
                raise self.failure or Refused(outcome.reason)
            missing |= leased.gone
            if not flown.before:
                return sorted(missing)
            self._go_without(missing)  # from now on they are somebody else's, to be kept clear of
            made += 1
            if made > MOST_APART:
                raise Refused("they drew apart again and again, and still rest too near to each other")

    async def _fly_motions(self, leased: LeasedVehicles, step: Fly, share: tuple[float, float]) -> list[str]:
        missing = set[str]()
        await self._settled(step.vehicles)  # who has just come there may still swing
        planned, why = await self.planner.check(step, self._view(), await leased.margins())
        if planned is not None:
            try:
                outcome = await self._flown(leased, planned, step.text, share)
                self._lanes = {name: left_over(step.motions[name], at) for name, at in outcome.flown.items()}
            except Refused as e:  # nobody has moved: a clock is not known well enough, or somebody drifted
                outcome = Outcome(False, e.message)
            self.check_stopped()
            if outcome.done:
                return []
            why, missing = outcome.reason, leased.gone
            self._go_without(missing)
            self.context.say("replan", "notice", f"{self.entry.id}: planned again: {why}", goal=self.entry.id)
            await self._settled()
        ways = [way for way in (without(each, missing) for each in step.instead) if way.vehicles]
        if not ways:
            raise Refused(f"{step.text or 'what was prepared'}: {why}; there is no other way")
        for way in ways:
            if lost := await self._plan_and_fly(leased, way, share):
                return sorted({*missing, *lost})
        return sorted(missing)

    async def _follow(self, leased: LeasedVehicles, step: Track, share: tuple[float, float]) -> list[str]:
        """Until the goal is cancelled, or its leader is lost for good; gives who did not come home or down then."""
        while True:
            tracking = Tracking(self, leased, step, self.planner)
            self.flying, self.tracks = tracking, True
            try:
                doing = await tracking.go_on()
            except Blocked as e:
                self.flying, self.tracks = None, False
                self.context.say("replan", "notice", f"{self.entry.id}: {e.message}: planned", goal=self.entry.id)
                await self._beside(leased, tracking, share)
                continue
            finally:
                self.flying, self.tracks = None, False
            self.check_stopped()
            goal: swarm.Goal = swarm.Return(vehicles=list(self.vehicles))
            if doing == "land":
                goal = swarm.Land(vehicles=list(self.vehicles))
            return sorted(await self._take_each(leased, await self.planner.resolve(goal, self._view()), set(), share))

    async def _beside(self, leased: LeasedVehicles, tracking: Tracking, share: tuple[float, float]) -> None:
        """By a plan to where the leader is now; where there is none, a little later perhaps."""
        places = np.array([enu(target.pos) for target in tracking.targets(leased.now)])
        try:
            await self._plan_and_fly(leased, PlanTo(self.vehicles, places, True, "on the way to the leader"), share)
        except PlanError as e:
            self.text(f"waits: {e.message}")
            await asyncio.sleep(SOON)
        self._state("flying", "follows")

    async def _planned(self, leased: LeasedVehicles, step: PlanTo, view: FleetView) -> Planned:
        async def margins() -> Margins:
            self.check_stopped()
            return await leased.margins()

        planned = await self.planner.patiently(step, view, margins, self.text)
        if planned.before:
            text = f"{self.entry.id}: first they draw apart: {planned.before}"
            self.context.say("room", "notice", text, goal=self.entry.id)
        return planned

    async def _flown(
        self,
        leased: LeasedVehicles,
        planned: Planned,
        text: str,
        share: tuple[float, float],
        again: Again | None = None,
    ) -> Outcome:
        self.check_stopped()  # it was stopped in between, where nothing was flown that could have come to rest
        self._speak_for(planned)
        self._state("flying", text or "flies")
        self.flying = leased
        try:
            return await leased.fly(planned, share, again)
        finally:
            self.flying = None

    def _speak_for(self, planned: Planned) -> None:
        """From now on no other goal plans through the room that this one needs."""
        radii = {vehicle.id: vehicle.radius for vehicle in planned.scene.vehicles}
        airspace = {name: [tube(motion[:, 1:], radii[name])] for name, motion in planned.motions.items()}
        self.context.airspace.hold(self.entry.id, airspace)
        self.entry.makespan, self.entry.clearance = planned.makespan, planned.clearance

    def _leave_room(self) -> None:
        """Its room is free again, but for the ways of those that are not heard, who may still be flying them."""
        context, name = self.context, f"{self.entry.id}/lost"
        held = context.airspace.drop(self.entry.id)
        lost = {vehicle: volumes for vehicle, volumes in held.items() if vehicle in context.fleet.hearing().unheard}
        if lost:
            context.airspace.hold(name, lost)
            context.later(self._leave_more(name, set(lost)))

    async def _leave_more(self, name: str, lost: set[str]) -> None:
        """Who is heard to rest flies none of it any more; after a while nobody does."""
        begun = time.monotonic()
        while time.monotonic() < begun + LASTING and any(
            resting.unrest(self.context, vehicle, begun) for vehicle in lost
        ):
            await asyncio.sleep(SOON)
        self.context.airspace.drop(name)

    # What it stands on.

    def _state(self, state: swarm.GoalState, text: str) -> None:
        if self.entry.state not in (*ENDED, "paused"):
            self.entry.state = state
        self.text(text)

    def _view(self, names: tuple[str, ...] = (), lost: set[str] | frozenset[str] = frozenset()) -> FleetView:
        """The fleet as known, with ``lost`` where they were heard last; raises :class:`Stale` where another one of
        ``names`` (all of ours) was not heard for long.
        """
        fleet, margin = self.context.fleet, self.context.settings.margin
        fleet.watch()
        view = fleet.view(margin, also=lost, tight=tight_of(self.entry.goal))
        missing = [name for name in names or self.vehicles if name not in view.vehicles]
        if missing:
            raise Stale(f"not heard any more: {', '.join(missing)}", vehicles=missing)
        return view

    def check_stopped(self) -> None:
        if self.stopping:
            raise asyncio.CancelledError

    async def _settled(self, names: tuple[str, ...] = (), patient: bool = False) -> set[str]:
        """Wait until these (all of ours) have said that they rest, or circle, and that nobody else commands them.

        Raises :class:`TimedOut`. ``patient``: where only some that are not heard are missing, gives these once they
        cannot be flying anything any more.
        """
        begun = time.monotonic()
        deadline = begun + SETTLE
        while waits := {
            name: why for name in names or self.vehicles if (why := resting.unrest(self.context, name, begun))
        }:
            waited, silent = (
                time.monotonic() - begun,
                {name for name in waits if not resting.heard(self.context, name, begun)},
            )
            if patient and waited > LASTING and silent == set(waits) != set(self.vehicles):
                text = f"{self.entry.id}: goes on without {', '.join(sorted(silent))}: not heard for {waited:.0f} s"
                self.context.say("lost", "warning", text, goal=self.entry.id)
                return silent
            reasons = [why for why in waits.values() if why != COMING]
            if time.monotonic() > deadline:
                raise TimedOut(f"not at rest after {SETTLE:.0f} s: {'; '.join(reasons[:5])}")
            if reasons:
                self.text(f"waits: {'; '.join(reasons[:3])}" + (" ..." if len(reasons) > 3 else ""))
            with contextlib.suppress(asyncio.TimeoutError):
                await self.context.z.news(0.5)
        return set()

    def place(self, name: str) -> Vector:
        """ENU, as last heard."""
        seen = self.context.fleet.seen(name)
        if seen is None:
            raise Stale(f"{name} is not heard any more", vehicle=name)
        return enu(seen.view.pos_ned)
