"""The ways home of a fleet as it is heard: who flies one by itself, among what, and what becomes of them.

:mod:`agents.planner.returning` finds and keeps them; docs/planner-return.md says what is promised.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from agents.planner.execute.commit import TAKING
from agents.planner.execute.track import flown
from agents.planner.goals.steps import FleetView, Fly, PlanTo, Step
from agents.planner.live.clocks import Clocks
from agents.planner.live.field import floor_of
from agents.planner.live.fleet import FRESH, Fleet, HeardVehicle
from agents.planner.live.frames import enu
from agents.planner.live.scenes import room_of
from agents.planner.live.settings import PlannerSettings
from agents.planner.live.tally import landing
from agents.planner.live.world import World
from agents.planner.model import world as still
from agents.planner.model.geometry import segment_clear, world_of
from agents.planner.model.problem import Floats, Motion, MovingObstacle
from agents.planner.model.scene import Bounds
from agents.planner.model.separation import separation
from agents.planner.returning.finder import DELAYS, LANDS_FROM, TRIED, Returner, Surroundings
from agents.planner.returning.keeper import ReturnKeeper
from agents.planner.returning.ways import Pace, Way

Say = Callable[..., None]
"""is told of what happens, as :meth:`~agents.planner.live.context.Context.say`"""
UNDER = 0.5
"""m below the ceiling that ways home stay"""
GRAIN = 50.0
"""m to which the bounds of the world are rounded, so that it is not made again while vehicles move"""
AT_START = 1.0
"""m from where its way home begins at which a vehicle may be to be sent along it at once"""
AT_HOME = 0.5
"""m over the ground from its home at which a way home ends there"""
NOT_OURS = ("nobody", "pilot", "order", "target")
"""what moves a vehicle that flies nothing of a planner's"""


class Homeward:
    """One for all goals of a planner. Lives on the event loop; :meth:`tick` is called a few times a second."""

    def __init__(
        self,
        fleet: Fleet,
        settings: PlannerSettings,
        world: World,
        clocks: Clocks,
        flying: Callable[[], Collection[str]],
        say: Say,
    ) -> None:
        self._fleet, self._settings, self._told = fleet, settings, world
        self._clocks, self._flying, self._say = clocks, flying, say
        self._world: tuple[tuple[Any, ...], still.World, still.World] | None = None
        """for what it was made, of what stands still, and with the ground"""
        self.keeper = ReturnKeeper(settings.downwash, self._returners, self._around, self._tell)

    def tick(self) -> None:
        """Forget the ways of those who are down, or whom somebody else has: they fly none of them."""
        flying = self._flying()
        for name in {*self.keeper.futures.parts, *self.keeper.last}:
            seen = self._fleet.seen(name)
            if seen is None:  # not heard for so long that it is down by now
                self.keeper.drop(name)
            elif seen.age >= FRESH or not self._over(name, seen):
                continue
            elif name in flying:
                self.keeper.idle(name)
            else:
                self.keeper.forget(name)

    def _over(self, name: str, seen: HeardVehicle) -> bool:
        """By what it says it flies nothing of ours, and takes nothing any more of what was put."""
        state = seen.state
        late = max((each.deadline for each in self.keeper.futures.of(name)), default=-math.inf) + TAKING
        return state.t > late and state.segment is None and (state.mover in NOT_OURS or not state.armed)

    def movers(self, but: Iterable[str], now: float) -> list[MovingObstacle]:
        """The ways home of those who are not heard, and may be on them, from ``now`` on our clock."""
        unheard = self._fleet.hearing().unheard - set(but)
        return [each.later(-now) for each in self.keeper.futures.movers(unheard)]

    # What the keeper asks.

    def _returners(self) -> Mapping[str, Returner]:
        fleet, found = self._fleet, dict[str, Returner]()
        for name in self.keeper.futures.parts:
            seen, after = fleet.seen(name), fleet.bodies.returns_after(name)
            if seen is None or after is None or seen.view.home_ned is None:
                continue
            if not (seen.view.hovers and seen.view.flies):
                continue
            body = seen.view.body
            pace = Pace(body.speed, body.climb, body.descend, seen.view.accel)
            left = fleet.battery_of(name)
            lasts = math.inf if left is None else left * body.endurance - landing(LANDS_FROM, seen.view)
            found[name] = Returner(enu(seen.view.home_ned), pace, after, lasts)
        return found

    def _around(self, names: Sequence[str], lowest: float, spacing: float) -> Surroundings:
        fleet, settings = self._fleet.all(), self._settings
        views = [seen.view for seen in fleet if seen.view.name in names]
        room = room_of(names, fleet, self._told.pieces(time.time()), [], set(), settings.downwash, None)
        floor = floor_of(settings.field, settings.ground, views)
        fences = [(settings.field.fence(view.name).ceiling, view.floor) for view in views]
        tops = (top - down for top, down in fences if top is not None and math.isfinite(top))
        ceiling = min(tops, default=lowest + UNDER + TRIED * spacing)
        if room.pieces.geofence is not None:
            ceiling = min(ceiling, room.pieces.geofence.ceiling)
        points = [enu(place) for view in views for place in (view.pos_ned, view.home_ned or view.pos_ned)]
        scene = room.empty(points)
        low = [math.floor(least / GRAIN) * GRAIN for least in scene.bounds.min]
        high = [math.ceil(most / GRAIN) * GRAIN for most in (*scene.bounds.max[:2], max(scene.bounds.max[2], ceiling))]
        bounds = Bounds(min=(low[0], low[1], low[2]), max=(high[0], high[1], high[2]))
        peak = None if floor is None else floor.peak([place[:2] for place in points])
        if peak is not None and peak <= ceiling - UNDER:
            lowest = max(lowest, peak)
        key = (bounds, scene.geofence, room.obstacles, floor)
        if self._world is None or self._world[0] != key:
            free = walled = world_of(msgspec.structs.replace(scene, bounds=bounds))
            if floor is not None:
                solid = [*scene.obstacles, *floor.columns(bounds, (), ())]
                walled = world_of(msgspec.structs.replace(scene, bounds=bounds, obstacles=solid))
            self._world = key, free, walled
        _, free, walled = self._world

        def clear(p: Floats, q: Floats, radius: float) -> bool:
            """Above the ground; straight up from there, and down where it lands, the ground is no obstacle."""
            return bool(segment_clear(free if np.array_equal(p[:2], q[:2]) else walled, p, q, radius))

        now = self._clocks.clock.now()
        later = [each.later(now) for each in room.movers]
        return Surroundings(clear, later, lowest, ceiling - UNDER, spacing)

    def _tell(self, vehicle: str, why: str) -> None:
        if why:
            text = f"{vehicle} has no way home now ({why}): it lands where it rests if the network is lost"
            self._say("home", "warning", text, vehicle=vehicle)
        else:
            self._say("home", "info", f"{vehicle} has a way home again", vehicle=vehicle)

    # At once.

    def at_once(self, steps: list[Step], view: FleetView) -> list[Step]:
        """The same steps of a return, by the ways home that its vehicles have, where all have one from where they are
        to where they took off; checked like every plan, and planned as ever where the verifier objects.
        """
        for number, step in enumerate(steps):
            if isinstance(step, PlanTo) and (motions := self._motions(step, view)):
                text = "by the way home that was ready"
                return [*steps[:number], Fly(motions, (step,), text), *steps[number + 1 :]]
        return steps

    def _motions(self, step: PlanTo, view: FleetView) -> dict[str, Motion] | None:
        found: dict[str, Motion] = {}
        for name, place in zip(step.vehicles, step.places, strict=True):
            way, seen = self.keeper.last.get(name), view.vehicles[name]
            if way is None or not _fits(way, seen.pos_ned, place):
                return None
            others = [(motion, view.vehicles[other].body.radius) for other, motion in found.items()]
            motion = self._first(way, seen.body.radius, others)
            if motion is None:
                return None
            found[name] = motion
        return found

    def _first(self, way: Way, radius: float, others: Sequence[tuple[Motion, float]]) -> Motion | None:
        """As soon as it is clear of the others."""
        for delay in DELAYS:
            motion = flown(way.at(delay).rows)
            if delay > 0.0:
                motion = np.vstack((np.array([[0.0, *motion[0, 1:]]]), motion))
            downwash = self._settings.downwash
            if all(separation(motion, other, downwash)[0] >= radius + wide for other, wide in others):
                return motion
        return None


def _fits(way: Way, here: Sequence[float], place: Floats) -> bool:
    x, y, z = here[1], here[0], -here[2]
    ends = way.corners[-1]
    near = math.dist(way.corners[0], (x, y, z)) <= AT_START
    return near and math.dist(ends[:2], place[:2]) <= AT_HOME and ends[2] >= place[2] - 2.0 * LANDS_FROM
