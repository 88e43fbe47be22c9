"""Staying beside something that moves: short segments again and again, each clear of everything and ending at rest.

Every follower is told a second at a time where to go for the next three, and how it would come to rest after that. The
conductor tells it, by its own rule (:mod:`agents.planner.execute.commit`): nobody is told anything that is not clear of
all that any other may be flying. When nothing more comes, whatever the reason, everybody rests within a few seconds.
"""

from __future__ import annotations

import time

import numpy as np

from agents.planner.execute.commit import Entry, Part
from agents.planner.execute.conductor import GUARD, LEAD, Conductor, Send
from agents.planner.execute.rows import ahead, head_of, knot
from agents.planner.execute.track import Profile, Track, state_at
from agents.planner.goals import follow
from agents.planner.goals.steps import GROUND, VehicleView
from agents.planner.goals.steps import Track as Step
from agents.planner.live.frames import enu, enu_array, ned, vector
from agents.planner.live.leased_vehicles import GoalUnderWay, LeasedVehicles
from agents.planner.live.plan import Planner
from agents.planner.live.reserved import Tube, tube
from agents.planner.model.geometry import segment_clear, world_of
from agents.planner.model.ground import Floor
from agents.planner.model.problem import MovingObstacle
from zmav.errors import BadInput, Refused, Stale
from zmav.wire import Vector

EVERY = 1.0
"""s between two segments of one follower"""
KNOTS = 5
"""steps of a motion from one point of a segment to the next"""
BLOCKED = 6.0
"""s without a clear segment after which a follower is brought to its place by a plan"""


class Tracking:
    """One follow goal under way: a source of motion for its own conductor. Lives on the event loop."""

    def __init__(self, run: GoalUnderWay, leased: LeasedVehicles, step: Step, planner: Planner) -> None:
        self._run, self._leased, self._goal, self._planner = run, leased, step.goal, planner
        self._due: dict[str, float] = {}
        self._told: dict[str, float] = {}
        self._said: follow.Doing | None = None
        self._leads = False
        self._waits: list[str] = []
        """who cannot be led to its place like this"""
        self._offsets, now = self._offsets_of(), leased.now
        self._parts = [self._part(name, now) for name in self._goal.vehicles]
        self._conductor = Conductor(self._parts, run.context.settings.downwash, now, source=self)

    async def go_on(self) -> follow.Doing:
        """Until it is stopped, or the leader is lost and the goal says to go home (``return``) or down (``land``).

        Raises :class:`Blocked` where a plan is to bring the followers to their places, and what a vehicle that follows
        us no more raises.
        """
        halted = await self._leased.follow(self._conductor, self._goes)
        if gone := [f"{part.id}: {part.off}" for part in self._parts if part.off]:
            raise Refused("; ".join(gone), vehicles=[part.id for part in self._parts if part.off])
        if halted or self._waits:
            raise Blocked(halted or f"{', '.join(self._waits)}: no clear way straight to its place")
        return self._said or "hold"

    def _goes(self) -> bool:
        """Once a tick: whether it goes on."""
        now, hearing = self._leased.now, self._run.context.fleet.hearing()
        doing = self._doing(now)
        self._leads = doing == "follow" and self._run.goes and hearing.may_move(self._run.vehicles)
        self._conductor.reserved.movers = self._leased.movers(now)
        if not self._leads:
            self._told.clear()  # who is not led is not blocked
        since = {part.id: self._told.setdefault(part.id, now) for part in self._parts} if self._leads else {}
        self._waits = [name for name, at in since.items() if now - at > BLOCKED]
        return not (self._run.stopping or doing in ("return", "land") or self._waits)

    # As whatever is flown is told: it looks for itself, within a tick.

    def halt(self, why: str = "") -> None: ...

    pause = resume = refresh = world_changed = halt

    @property
    def committed(self) -> list[MovingObstacle]:
        """All that each follower may be flying, on our UTC."""
        return self._leased.committed

    # Whom it follows.

    def leader(self, now: float) -> tuple[follow.MovingTarget, float]:
        """Where it is (NED, our UTC), and s since that was heard. Raises :class:`Stale`."""
        goal, context = self._goal, self._run.context
        seen = context.fleet.seen(goal.leader)
        if seen is not None:
            return follow.MovingTarget(now - seen.age, seen.view.pos_ned, seen.view.vel_ned), seen.age
        ball = context.world.ball(goal.leader, time.time())
        if ball is None:
            raise Stale(f"nobody has heard of {goal.leader}", vehicle=goal.leader)
        return follow.MovingTarget(now, *ball), 0.0

    def _doing(self, now: float) -> follow.Doing:
        try:
            age = self.leader(now)[1]
        except Stale:
            age = self._goal.lost_after * 3.0
        doing = follow.doing(self._goal, age)
        if doing != self._said:
            lost = f"{self._goal.leader} is not heard: {doing}" if doing != "follow" else ""
            if lost or self._said:
                text = lost or f"{self._goal.leader} is heard again"
                self._run.context.say("leader", "warning" if lost else "notice", f"{self._run.entry.id}: {text}")
            self._run.text(lost or f"following {self._goal.leader}")
            self._said = doing
        return doing

    def _offsets_of(self) -> list[Vector]:
        context = self._run.context
        margin = context.settings.margin
        views = context.fleet.view(margin).pick(self._goal.vehicles)
        leader = context.fleet.seen(self._goal.leader)
        radius = leader.view.body.radius + margin if leader else margin
        return follow.offsets_of(self._goal, [view.body for view in views], radius, context.settings.downwash)

    def targets(self, now: float) -> list[follow.MovingTarget]:
        """Everybody's place beside the leader (NED)."""
        leader, _ = self.leader(now)
        return [follow.slot(leader, offset, now) for offset in self._offsets]

    # What followers fly.

    def _part(self, name: str, now: float) -> Part:
        seen = self._run.context.fleet.seen(name)
        if seen is None:
            raise Stale(f"{name} is not heard any more", vehicle=name)
        command, body = self._leased.commands[name], seen.view.body
        place = np.array(enu(seen.view.pos_ned))
        command.offset.fix()
        error = command.offset.error(now)
        margin = self._leased.tracking + body.speed * error
        part = Part(name, Track(np.array([[0.0, *place]])), body.radius, body.accel, margin, command.offset)
        part.heard, part.error, part.instance = now, error, command.instance
        part.follows(self._leased.followings[name])
        return part

    def next(self, part: Part, now: float) -> Send | None:
        """One more second, where that is due and clear of everything."""
        if not self._leads or now < self._due.get(part.id, 0.0):
            return None
        number = self._parts.index(part)
        target = self.targets(now)[number]
        names, context = self._goal.vehicles, self._run.context
        views = context.fleet.view(context.settings.margin, also=names).vehicles.values()
        room = self._planner.room(names, [view for view in views if view.name in names])
        world = world_of(room.empty([enu(target.pos), vector(state_at(part.known.rows, now)[0])]))
        entry = self._next(part, target, now)
        moved, radius = entry.samples[:, 1:], part.need
        clear = all(
            segment_clear(world, np.ascontiguousarray(p), np.ascontiguousarray(q), radius)
            for p, q in zip(moved[:-1:2], moved[2::2], strict=False)
        )
        way = tube(moved[::3], radius)
        clear = clear and self._is_high_enough(part.id, room.floor, entry)
        blocker = self._conductor.reserved.blocker(part, entry, now) if clear else "an obstacle"
        if blocker or self._tubes_blocked(part, way):
            self._due[part.id] = now + 0.3
            return None
        self._run.context.airspace.hold(self._run.entry.id, {part.id: [tube(part.known.samples[::3, 1:], radius), way]})
        return Send(part, entry, ahead(entry.rows, now), entry.departs - GUARD - part.error)

    def _is_high_enough(self, name: str, floor: Floor | None, entry: Entry) -> bool:
        """By the vehicle's own rule, where some of them drive and there are no columns to keep out of."""
        view = self._view(name)
        if floor is None or floor.walls or not view.flies:
            return True
        try:
            floor.check(entry.samples[::3].tolist(), None if view.home_ned is None else enu(view.home_ned))
        except BadInput:
            return False
        return True

    def told(self, part: Part, now: float) -> None:
        self._due[part.id] = now + EVERY
        self._told[part.id] = now
        self._run.context.told(self._run.entry.id)

    def _tubes_blocked(self, part: Part, way: Tube) -> str:
        context = self._run.context
        return context.airspace.blocker(context.kin(self._run.entry.id), {part.id: [way]}, context.settings.downwash)

    def _next(self, part: Part, target: follow.MovingTarget, now: float) -> Entry:
        """From where its trajectory has it at a point of it soon, towards its place, and to rest."""
        d = knot(part.known, now + LEAD)
        pos, vel = state_at(part.known.rows, d)
        begin = follow.MovingTarget(d, ned(vector(pos)), ned(vector(vel)))
        view = self._view(part.id)
        level = view.kind in GROUND
        motion = follow.segment(begin, target, view.body, level=level)
        times, places = motion[:, 0], enu_array(motion[:, 1:])
        keep = sorted({0, *range(KNOTS, len(times), KNOTS), len(times) - 1})
        speeds = np.gradient(places, times, axis=0) if len(times) > 2 else np.zeros_like(places)
        rows = np.column_stack((times[keep], places[keep], speeds[keep]))
        rows[-1, 4:] = 0.0
        whole = np.vstack((head_of(part.known, d, now - part.late), rows[1:]))
        rest_at = float(whole[-1, 0])
        return Entry(Profile.resting(0.0, rest_at), np.round(whole, 6), d, rest_at, late=part.late)

    # Who is what.

    def _view(self, name: str) -> VehicleView:
        seen = self._run.context.fleet.seen(name)
        assert seen is not None
        return seen.view


class Blocked(Refused):
    """Followers are to be brought to their places by a plan."""
