"""From a step to a verified plan: the scene is put together here, the solver's process does the rest."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.planner.goals.formation import offsets_of
from agents.planner.goals.steps import FleetView, Fly, PlanTo, Step, VehicleView
from agents.planner.goals.sweeping import sweepers_of
from agents.planner.live import jobs
from agents.planner.live.apart import Surroundings, apart, free
from agents.planner.live.context import Context
from agents.planner.live.field import floor_of
from agents.planner.live.frames import enu, ned, vector
from agents.planner.live.scenes import Room, moved, resized, room_of, scene_of
from agents.planner.live.solver import Solver, SolverDied
from agents.planner.model.errors import PlanError
from agents.planner.model.problem import Motion, MovingObstacle
from agents.planner.model.scene import Scene
from agents.planner.model.separation import separation
from agents.planner.model.verify import Report
from agents.planner.solve.loiter import loiter_radius
from zmav.errors import BadInput, Refused
from zmav.wire import Vector, swarm

Margins = Sequence[tuple[float, float]]
"""m by which radii are widened, and the share of their speed that vehicles may have; best first"""
CLEARLY, NARROW, SMALLEST = 0.15, 0.01, 0.2
"""m more than needed that vehicles draw apart, for they do not rest exactly where they should; m less than there is
that their plan reckons with; and the share of its own radius that each has at least in it, however near another is"""
MOST_APART = 3
"""times that vehicles draw apart before one plan"""
CLOSE = ("starts_overlap", "start_in_obstacle")
"""kinds of errors of plans that cannot begin because somebody rests too near to somebody or something"""
SILENCE = 60.0
"""s that a plan waits for vehicles that are not heard and for aircraft, where there is no room beside them"""
PASSES = ("starts_overlap", "goals_overlap", "unreachable", "timeout")
"""kinds of errors of plans that an aircraft may be the cause of"""
SOON, LATER = 1.0, 5.0
"""s between two tries to plan where there was no room, or no solver, at least and at most; in between as long as the
try before took: what takes long to be refused is refused again, and others wait for the solver, too"""
MOST_DEATHS = 3
"""of the solver, after which a plan is given up: it dies of it"""
LAYER = 30.0
"""m of height for each plane above the one below it"""


@dataclass(frozen=True)
class Planned:
    """What is to be flown, verified."""

    motions: Mapping[str, Motion]
    """by vehicle: (T, 4) t, x, y, z (ENU)"""
    scene: Scene
    makespan: float
    clearance: float | None
    margin: float
    """m by which every vehicle's radius in the scene is larger than its own"""
    above_ground: float | None = None
    """m: the least; None: the ground is not known"""
    before: str = ""
    """why it only makes room, and what is to be flown is planned from where it ends; "": it is that"""


class Planner:
    """For one goal. ``view``: the fleet as it will be when the step begins, its radii with the margin in them."""

    def __init__(self, context: Context, goal: str, solver: Solver) -> None:
        self._context, self._goal, self._solver = context, goal, solver

    def room(self, vehicles: Sequence[str], ours: Sequence[VehicleView]) -> Room:
        """Everything that these are to keep clear of now. ``ours``: as planned for, all room in their radii."""
        context = self._context
        kin = context.kin(self._goal)
        walls = context.airspace.walls(kin, context.settings.downwash)
        taken = context.airspace.vehicles(kin)
        pieces = context.world.pieces(time.time(), lasting=True)
        views, settings = context.fleet.all(), context.settings
        floor = floor_of(settings.field, settings.ground, ours)
        room = room_of(vehicles, views, pieces, walls, taken, settings.downwash, floor)
        lost = context.homes.movers(vehicles, context.clocks.clock.now())
        return replace(room, movers=(*room.movers, *lost))

    async def resolve(self, goal: swarm.Goal, view: FleetView) -> list[Step]:
        """What the goal comes down to; raises the typed error of one that cannot be."""
        room = self.room(goal.vehicles, view.pick(goal.vehicles))
        points: list[Vector] = [enu(view.vehicles[name].pos_ned) for name in goal.vehicles]
        points += [enu(point) for point in points_of(goal, view)]
        if isinstance(goal, swarm.Search) and goal.above_ground and room.floor is not None:
            easts, norths = [east for _, east in goal.polygon], [north for north, _ in goal.polygon]
            span = room.floor.span((min(easts), min(norths), max(easts), max(norths)))
            points += [(min(easts), min(norths), z + goal.height) for z in span]
        points += circles(goal, view, points)
        starts = [enu(view.vehicles[name].pos_ned) for name in goal.vehicles]
        scene = room.empty(points, starts)
        floor = None if room.floor is None else room.floor.within(scene.bounds)
        return await self._solver.do(jobs.Resolve(goal, view, scene, floor))

    async def steps(self, goal: swarm.Goal, view: FleetView) -> list[Step]:
        """As they are flown now: a return by the ways home that are ready."""
        found = await self.resolve(goal, view)
        return self._context.homes.at_once(found, view) if isinstance(goal, swarm.Return) else found

    async def plan_to(self, step: PlanTo, view: FleetView, margins: Margins = ()) -> Planned:
        """With the first of ``margins`` for which there is a plan: where it is tight, less. None given: the settings',
        or half of it. Raises :class:`PlanError`, :class:`TimedOut` and what else the solver's process may fail with.
        """
        own = self._context.settings.margin
        tries = list(margins or self._usual)
        while True:
            margin, share = tries.pop(0)
            try:
                radii = {name: each.body.radius + margin - own for name, each in view.vehicles.items()}
                return await self._plan(step, resized(view, radii, share), margin)
            except PlanError as e:
                if not tries or e.kind == "invalid_scene":
                    raise

    async def next_to(self, step: PlanTo, view: FleetView, margins: Margins = ()) -> Planned:
        """As :meth:`plan_to`; where somebody rests too near for that, what is flown first, which makes room."""
        try:
            return await self.plan_to(step, view, margins)
        except PlanError as e:
            if e.kind not in CLOSE or (first := await self._make_room(step, view, margins or self._usual)) is None:
                raise
            return replace(first, before=e.message)

    async def patiently(
        self,
        step: PlanTo,
        view: FleetView,
        margins: Callable[[], Awaitable[Margins]],
        say: Callable[[str], None],
    ) -> Planned:
        """As :meth:`next_to`, where there is room: what other goals have spoken for is waited for, and for a while who
        is not heard and in the way, and aircraft that pass. ``margins`` is asked before each try and each second
        between, so that it may end the wait by what it raises; ``say`` is told what is waited for.
        """
        context, deaths, begun = self._context, 0, time.monotonic()
        again = begun
        while True:
            wanted = await margins()
            tried = time.monotonic()
            if tried < again:
                await asyncio.sleep(min(SOON, again - tried))
                continue
            if tried < begun + SILENCE and (who := self._over(view.pick(step.vehicles))):
                say(f"waits for room beside {who}: it is about to pass")
                again = tried + SOON
                continue
            try:
                return await self.next_to(step, view, wanted)
            except PlanError as e:
                others = sorted({goal for goal, _, _ in context.airspace.others(context.kin(self._goal))})
                patient = time.monotonic() < begun + SILENCE
                passing = [each.obstacle.name for each in context.world.traffic] if e.kind in PASSES else []
                silent = sorted([*context.fleet.hearing().unheard, *passing]) if patient else []
                if not (others or silent) or e.kind == "invalid_scene":
                    raise
                say(f"waits for room beside {', '.join([*others, *silent])}: {e.message}")
            except SolverDied as e:
                deaths += 1
                if deaths > MOST_DEATHS:
                    raise
                say(f"planned again: {e.message}")
            now = time.monotonic()
            again = now + min(max(SOON, now - tried), LATER)

    def _over(self, views: Sequence[VehicleView]) -> str:
        """The aircraft that one of these cannot get away from, or is too near to by now; empty: none. No plan has it
        come nearer, and all that a solver may try is in vain until it has passed.
        """
        world, downwash = self._context.world, self._context.settings.downwash
        aircraft = {f"@{each.obstacle.name}": each.obstacle.name for each in world.traffic}
        for mover in world.pieces(time.time(), lasting=True).movers if aircraft else ():
            for view in views if mover.id in aircraft else ():
                tried = [separation(way, mover.motion, downwash, b_leaves=True)[0] for way in _ways_out(view, mover)]
                if max(tried) < view.body.radius + mover.radius:
                    return aircraft[mover.id]
        return ""

    @property
    def _usual(self) -> Margins:
        own = self._context.settings.margin
        return (own, 1.0), (own / 2.0, 1.0)

    async def _make_room(self, step: PlanTo, view: FleetView, margins: Margins) -> Planned | None:
        """Apart with those who rest too near to each other, or to an obstacle, for a plan with even the last of
        ``margins``: as slowly as that says, with what room there is. None where nobody does, or there is no way apart.
        """
        views = view.pick(step.vehicles)
        room = self.room(step.vehicles, views)
        if not all(each.hovers for each in views):
            return None
        around = Surroundings(room.obstacles, room.movers, room.downwash)
        places = np.array([enu(each.pos_ned) for each in views], dtype=np.float64)
        radii = np.array([each.body.radius for each in views]) - self._context.settings.margin
        (margin, share), spare = margins[-1], await asyncio.to_thread(free, places, radii, around)
        if float(spare.min()) >= margin:
            return None
        for wanted in sorted({wider for wider, _ in margins[1:]}, reverse=True):
            goals = await asyncio.to_thread(apart, places, radii + wanted + CLEARLY, around)
            if goals is None:
                continue
            widths = np.maximum(radii * SMALLEST, radii + np.minimum(margin, spare - NARROW))
            slow = resized(view, dict(zip(step.vehicles, widths.tolist(), strict=True)), share)
            try:
                found = await self._plan(PlanTo(step.vehicles, goals, True, step.text), slow, margin)
            except (PlanError, Refused):
                continue
            return replace(found, clearance=None)  # less than their radii at first
        return None

    async def _plan(self, step: PlanTo, view: FleetView, margin: float) -> Planned:
        views = view.pick(step.vehicles)
        room = self.room(step.vehicles, views)
        scene = scene_of(views, step.places, step.labelled, room)
        seconds = self._context.settings.plan_seconds
        motions, judged = await self._solver.do(jobs.Solve(scene, room.movers, seconds))
        try:
            above = await asyncio.to_thread(_above, room, views, motions)
        except BadInput as e:
            raise Refused(f"the verifier objects: {e.message}") from e
        return Planned(motions, scene, judged.makespan, _wider(judged, margin, views), margin, above)

    async def check(self, step: Fly, view: FleetView, margins: Margins = ()) -> tuple[Planned | None, str]:
        """Prepared motions as a plan, where the verifier lets them pass among all that is there now; or why not. With
        the most of ``margins`` with which it does, and the settings' own at least.
        """
        own, why = self._context.settings.margin, ""
        for margin in sorted({own, *(each for each, share in margins if share == 1.0 and each > own)}, reverse=True):
            radii = {name: each.body.radius + margin - own for name, each in view.vehicles.items()}
            planned, why = await self._check(step, resized(view, radii), margin)
            if planned is not None:
                return planned, ""
        self._context.say("plan", "info", f"{self._goal}: not as prepared: {why}", goal=self._goal)
        return None, why

    async def _check(self, step: Fly, view: FleetView, margin: float) -> tuple[Planned | None, str]:
        motions, names = step.motions, tuple(step.motions)
        places = np.array([motion[-1, 1:] for motion in motions.values()])
        # The vehicles hover about where their motions start.
        starts = {name: ned(vector(motion[0, 1:])) for name, motion in motions.items()}
        corners = [vector(end(motion[:, 1:], axis=0)) for motion in motions.values() for end in (np.min, np.max)]
        views = moved(view, starts).pick(names)
        room = self.room(names, views)
        scene = scene_of(views, places, True, replace(room, floor=None), corners)
        judged = await self._solver.do(jobs.Judge(scene, motions, room.movers))
        if not judged.ok:
            return None, str(judged.faults[0])
        try:
            above = await asyncio.to_thread(_above, room, views, motions)
        except BadInput as e:
            return None, e.message
        return Planned(motions, scene, judged.makespan, _wider(judged, margin, views), margin, above), ""


def _ways_out(view: VehicleView, mover: MovingObstacle) -> list[Motion]:
    """Straight away from where it is, and from the line that it moves along: over the ground, at the vehicle's speed
    and from now.
    """
    begins, ends = mover.motion[0], mover.motion[-1]
    here = np.array(enu(view.pos_ned))
    off, (east, north) = here[:2] - begins[1:3], ends[1:3] - begins[1:3]
    across = np.array([-north, east])
    ways = []
    for way in (off, across if across @ off >= 0.0 else -across):
        flown = view.body.speed * (ends[0] - begins[0]) * way / max(float(np.linalg.norm(way)), 1e-9)
        ways.append(np.array([[begins[0], *here], [ends[0], *(here[:2] + flown), here[2]]]))
    return ways


def _wider(judged: Report, margin: float, views: Sequence[VehicleView]) -> float | None:
    """m between the vehicles themselves, where they say that they are: what was planned for is larger. None: of one."""
    room = 2.0 * margin + sum(sorted(view.room for view in views)[:2])
    return None if judged.closest is None else judged.clearance + room


def _above(room: Room, views: Sequence[VehicleView], flown: Mapping[str, Motion]) -> float | None:
    """The least height above the ground of all that fly. Raises :class:`BadInput` for what a vehicle would refuse."""
    if room.floor is None:
        return None
    homes = {view.name: None if view.home_ned is None else enu(view.home_ned) for view in views if view.flies}
    found = [room.floor.check(flown[name].tolist(), home) for name, home in homes.items()]
    return min((each for each in found if each is not None), default=None)


def circles(goal: swarm.Goal, view: FleetView, points: Sequence[Vector]) -> list[Vector]:
    """Room (ENU) that planes need beyond these places: for their circles, which are above each other, and turns."""
    planes = [view.vehicles[name] for name in goal.vehicles if not view.vehicles[name].hovers]
    if not planes:
        return []
    homes = [enu(plane.home_ned) for plane in planes if plane.home_ned is not None]
    wide = 3.0 * max(loiter_radius(plane.body) for plane in planes)
    x, y, z = np.array([*points, *homes]).T
    low, high = float(z.min()), float(z.max()) + len(planes) * LAYER
    return [(float(x.min()) - wide, float(y.min()) - wide, low), (float(x.max()) + wide, float(y.max()) + wide, high)]


def points_of(goal: swarm.Goal, view: FleetView) -> list[Vector]:
    """Every place (NED) that a goal names."""
    found: list[Vector] = []
    for field in ("to", "via"):
        found += getattr(goal, field, [])
    if isinstance(goal, swarm.Formation):
        offsets = offsets_of(goal, len(goal.vehicles))
        reach, lowest, highest = float(np.abs(offsets).max()), float(offsets[:, 2].max()), float(offsets[:, 2].min())
        for north, east, down in (goal.at, *goal.via):
            found += [(north - reach, east - reach, down + highest), (north + reach, east + reach, down + lowest)]
    if isinstance(goal, swarm.Search):
        if goal.above_ground:
            return found + [(n, e, view.vehicles[goal.vehicles[0]].pos_ned[2]) for n, e in goal.polygon]
        heights = {each.height for each in sweepers_of(goal, view.pick(goal.vehicles))}
        found += [(n, e, -height) for n, e in goal.polygon for height in heights]
    if isinstance(goal, swarm.Land):
        found += [(n, e, 0.0) for n, e in goal.at]
    return found
