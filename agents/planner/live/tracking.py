"""Staying beside something that moves: short segments again and again, each clear of everything and ending at rest.

Every follower is told a second at a time where to go for the next three, and how it would come to rest after that. The
rule is the executor's own (:mod:`agents.planner.execute.commit`): nobody is told anything that is not clear of all that
any other may be flying. When nothing more comes, whatever the reason, everybody rests within a few seconds.
"""

from __future__ import annotations

import asyncio
import time

import numpy as np

from agents.planner.execute.commit import Entry, Part, Reserved
from agents.planner.execute.track import Profile, Track, state_at
from agents.planner.goals import follow
from agents.planner.goals.steps import GROUND
from agents.planner.goals.steps import Track as Step
from agents.planner.live.frames import enu, enu_array, ned
from agents.planner.live.leased_vehicles import GoalUnderWay, LeasedVehicles
from agents.planner.live.plan import Planner
from agents.planner.live.reserved import Tube, tube
from agents.planner.model.geometry import segment_clear, world_of
from agents.planner.model.problem import Floats, MovingObstacle
from zmav.errors import Refused, Stale
from zmav.wire import Vector, swarm

TICK, EVERY = 0.1, 1.0
"""s between two looks, and between two segments of one follower"""
LEAD, GUARD = 0.8, 0.05
"""s ahead at which a new segment leaves the old one, and before that by which it must have been taken"""
RESEND = 0.3
APART = 0.05
"""s between two points at least: vehicles refuse those that are nearer than 0.02"""
KNOTS = 5
"""steps of a motion from one point of a segment to the next"""
BLOCKED = 6.0
"""s without a clear segment after which a follower is brought to its place by a plan"""


class Tracking:
    """One follow goal under way. Lives on the event loop."""

    def __init__(self, run: GoalUnderWay, leased: LeasedVehicles, step: Step, planner: Planner) -> None:
        self._run, self._leased, self._goal, self._planner = run, leased, step.goal, planner
        self._commands = leased.commands
        self._parts: list[Part] = []
        self._heading: follow.Heading | None = None
        self._due: dict[str, float] = {}
        self._told: dict[str, float] = {}
        self._said = ""
        self._offsets = self._offsets_of()
        self._begin(leased.now)

    async def go_on(self) -> follow.Doing:
        """Until it is stopped, or the leader is lost and the goal says to go home (``return``) or down (``land``)."""
        try:
            while not self._run.stopping:
                now = self._leased.now
                self._hear(now)
                doing = self._doing(now)
                if doing in ("return", "land"):
                    return doing
                hearing = self._run.context.fleet.hearing()
                if doing != "hold" and self._run.goes and hearing.may_move(self._run.vehicles):
                    self._lead(now)
                    self._check_blocked(now)
                else:
                    self._told.clear()  # who is not led is not blocked
                await asyncio.sleep(TICK)
            return "hold"
        finally:
            await asyncio.shield(self._rest())

    # As whatever is flown is told.

    def stop(self, why: str) -> None:
        """Its loop sees it within a tick."""

    def pause(self) -> None:
        """So it does this."""

    def resume(self) -> None:
        """And this."""

    @property
    def committed(self) -> list[MovingObstacle]:
        """All that each follower may be flying, on our UTC."""
        return [MovingObstacle(part.id, entry.samples, part.need) for part in self._parts for entry in part.entries]

    def refresh(self) -> None:
        """Each segment is checked against what the leader is committed to then."""

    def world_changed(self) -> None:
        """Each segment is checked against the world as it is then."""

    # Whom it follows.

    def leader(self, now: float) -> tuple[follow.MovingTarget, float | None, float]:
        """Where it is (NED, our UTC), where it looks (rad), s since that was heard. Raises :class:`Stale`."""
        goal, context = self._goal, self._run.context
        seen = context.fleet.seen(goal.leader)
        if seen is not None:
            yaw = seen.state.attitude.yaw if seen.state.attitude else None
            return follow.MovingTarget(now - seen.age, seen.view.pos_ned, seen.view.vel_ned), yaw, seen.age
        ball = context.world.ball(goal.leader, time.time())
        if ball is None:
            raise Stale(f"nobody has heard of {goal.leader}", vehicle=goal.leader)
        return follow.MovingTarget(now, *ball), None, 0.0

    def _doing(self, now: float) -> follow.Doing:
        try:
            age = self.leader(now)[2]
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
        leader, yaw, _ = self.leader(now)
        bodies = [self._body(part.id) for part in self._parts]
        most = follow.most_turn(self._offsets, bodies, float(np.linalg.norm(leader.vel)))
        heading = self._heading = follow.heading_of(self._heading, leader.at(now), yaw, most)
        return [follow.slot(leader, heading, offset, self._goal.frame, now) for offset in self._offsets]

    # What followers fly.

    def _begin(self, now: float) -> None:
        for name in self._goal.vehicles:
            seen = self._run.context.fleet.seen(name)
            if seen is None:
                raise Stale(f"{name} is not heard any more", vehicle=name)
            command, body = self._commands[name], seen.view.body
            place = np.array(enu(seen.view.pos_ned))
            command.offset.fix()
            margin = self._leased.tracking + body.speed * command.offset.error(now)
            track = Track(np.array([[0.0, *place]]))
            part = Part(name, track, body.radius, body.accel, margin, command.offset)
            part.entries.append(_standing(place, now))
            part.heard = now
            self._parts.append(part)
        self._reserved = Reserved(self._parts, self._run.context.settings.downwash)

    def _hear(self, now: float) -> None:
        for part in list(self._parts):
            command = self._commands[part.id]
            if command.taken:
                raise Refused(f"{part.id}: {command.taken}", vehicle=part.id)
            news = command.news()
            if news is None:
                continue
            state, part.heard = news
            segment = state.segment
            part.acknowledge((segment.lease, segment.seq) if segment else None, state.t)

    def _lead(self, now: float) -> None:
        """Send again what is not taken yet, and one more second to whom it is due."""
        self._reserved.movers = self._leased.movers(now)
        targets = self.targets(now)
        room = self._planner.room(self._goal.vehicles)
        world = world_of(room.empty([enu(target.pos) for target in targets] + self._places(now)))
        for part, target in zip(self._parts, targets, strict=True):
            if part.pending:
                entry = part.latest
                if now - entry.last_sent > RESEND and now < entry.departs - 2.0 * GUARD:
                    self._put(part, entry, now)
                continue
            if now < self._due.get(part.id, 0.0):
                continue
            entry = self._next(part, target, now)
            moved = entry.samples[:, 1:]
            radius = part.need
            clear = all(
                segment_clear(world, np.ascontiguousarray(p), np.ascontiguousarray(q), radius)
                for p, q in zip(moved[:-1:2], moved[2::2], strict=False)
            )
            way = tube(moved[::3], radius)
            blocker = self._reserved.blocker(part, entry, now) if clear else "an obstacle"
            blocker = blocker or self._tubes_blocked(part, way)
            if blocker:
                self._due[part.id] = now + 0.3
                continue
            self._run.context.airspace.hold(
                self._run.entry.id, {part.id: [tube(part.known.samples[::3, 1:], radius), way]}
            )
            self._put(part, entry, now)

    def _tubes_blocked(self, part: Part, way: Tube) -> str:
        context = self._run.context
        return context.airspace.blocker(context.kin(self._run.entry.id), {part.id: [way]}, context.settings.downwash)

    def _next(self, part: Part, target: follow.MovingTarget, now: float) -> Entry:
        """From where its trajectory has it soon, towards its place, and to rest."""
        d = now + LEAD
        pos, vel = state_at(part.known.rows, d)
        begin = follow.MovingTarget(d, ned(_three(pos)), ned(_three(vel)))
        level = self._kind(part.id) in GROUND
        motion = follow.segment(begin, target, self._body(part.id), level=level)
        times, places = motion[:, 0], enu_array(motion[:, 1:])
        keep = sorted({0, *range(KNOTS, len(times), KNOTS), len(times) - 1})
        speeds = np.gradient(places, times, axis=0) if len(times) > 2 else np.zeros_like(places)
        rows = np.column_stack((times[keep], places[keep], speeds[keep]))
        rows[0, 4:], rows[-1, 4:] = vel, 0.0
        head = _head(part.known.rows, d, now)
        whole = np.vstack((head, rows))
        rest_at = float(whole[-1, 0])
        return Entry(Profile.resting(0.0, rest_at), np.round(whole, 6), d, rest_at)

    def _put(self, part: Part, entry: Entry, now: float) -> None:
        done = self._commands[part.id].put(entry.rows, entry.departs - GUARD - part.offset.error(now))
        if done is None:
            return
        stamp, deadline = done
        entry.sent.append(stamp)
        entry.deadline, entry.last_sent = max(entry.deadline, deadline), now
        if not part.pending:
            part.entries.append(entry)
            self._due[part.id] = now + EVERY
            self._told[part.id] = now
            self._run.context.told(self._run.entry.id)

    def _check_blocked(self, now: float) -> None:
        """Raise :class:`Blocked` where a follower cannot be led to its place like this: a plan brings it there."""
        waits = [part.id for part in self._parts if now - self._told.setdefault(part.id, now) > BLOCKED]
        if waits:
            raise Blocked(f"{', '.join(waits)}: no clear way straight to its place")

    async def _rest(self) -> None:
        """Nobody's lease is given back while it moves: it would stop at once, and not along its way."""
        while any(entry.rest_at > self._leased.now for part in self._parts for entry in part.entries):
            self._hear_quietly()
            await asyncio.sleep(TICK)

    def _hear_quietly(self) -> None:
        for part in self._parts:
            news = self._commands[part.id].news()
            if news is not None:
                segment = news[0].segment
                part.acknowledge((segment.lease, segment.seq) if segment else None, news[0].t)

    # Who is where.

    def _places(self, now: float) -> list[Vector]:
        return [_three(state_at(part.known.rows, now)[0]) for part in self._parts]

    def _body(self, name: str) -> swarm.Body:
        seen = self._run.context.fleet.seen(name)
        assert seen is not None
        return seen.view.body

    def _kind(self, name: str) -> str:
        seen = self._run.context.fleet.seen(name)
        assert seen is not None
        return seen.view.kind


class Blocked(Refused):
    """Followers are to be brought to their places by a plan."""


def _standing(place: Floats, now: float) -> Entry:
    rows = np.array([[now - 1.0, *place, 0.0, 0.0, 0.0], [now, *place, 0.0, 0.0, 0.0]])
    return Entry(Profile.resting(0.0, now), np.round(rows, 6), now, now)


def _head(rows: Floats, d: float, now: float) -> Floats:
    """The points up to ``d`` (not at it, nor so near that a vehicle refuses it), from just before now; of what rests by
    then, its place.
    """
    before = rows[rows[:, 0] <= d - APART]
    first = max(int(np.searchsorted(before[:, 0], now - 0.2)) - 1, 0)
    kept: Floats = before[first:]
    if len(kept) and kept[-1, 0] > now - 4.0 and rows[-1, 0] > now - 0.2:
        return kept
    rest = rows[-1:].copy()
    rest[0, 0], rest[0, 4:] = now - 0.3, 0.0
    return rest


def _three(place: Floats) -> Vector:
    x, y, z = map(float, place)
    return (x, y, z)
