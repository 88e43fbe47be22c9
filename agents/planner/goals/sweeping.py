"""A search goal as steps: to where the lanes begin, all lanes on one clock, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agents.planner.goals import crowd, slots
from agents.planner.goals.dealing import Ground, Part, Sweeper
from agents.planner.goals.search import Split, ground, split
from agents.planner.goals.steps import Fly, PlanTo, Step, VehicleView
from agents.planner.goals.timing import Limits
from agents.planner.live import frames
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.scene import Scene
from zmav import wire

MOST_STOPS = 200
"""places one after another, in which lanes are flown where they cannot be flown on one clock"""


def search(goal: wire.swarm.Search, views: Sequence[VehicleView], scene: Scene) -> list[Step]:
    """The steps of a search; those for whom nothing is left stay where they are.

    Raises what :func:`agents.planner.goals.search.ground` and :func:`~agents.planner.goals.search.split` raise.
    """
    slots.check_flying(views, "search")
    slots.check_hovering(views, "search")
    sweepers = sweepers_of(goal, views)
    heights = (min(s.height for s in sweepers), max(s.height for s in sweepers))
    polygon = [(float(east), float(north)) for north, east in goal.polygon]
    area = ground(polygon, scene, heights, max(s.radius for s in sweepers))
    course = None if goal.angle is None else frames.course_of(goal.angle)
    return _steps(split(area, sweepers, goal.overlap, course), area, scene, views)


def sweepers_of(goal: wire.swarm.Search, views: Sequence[VehicleView]) -> list[Sweeper]:
    """The vehicles as a search sees them, in the goal's order."""
    sweepers = []
    for view in views:
        body, (east, north, up) = view.body, frames.enu(view.pos_ned)
        sweepers.append(
            Sweeper(
                name=view.name,
                start=np.array([east, north, up]),
                height=goal.height if view.flies else up,
                width=body.sweep_width,
                speed=body.speed,
                accel=body.accel,
                climb=min(body.climb, body.descend),
                endurance=body.endurance,
                radius=body.radius,
            )
        )
    return sweepers


def _steps(dealt: Split, area: Ground, scene: Scene, views: Sequence[VehicleView]) -> list[Step]:
    """To the lanes, over them, and back to where everybody was."""
    parts, busy = dealt.parts, [part for part in dealt.parts if len(part.path)]
    limits = {view.name: slots.limits_of([view]) for view in views}
    own = {view.name: view for view in views}
    ways = [_way(part, area, limits[part.sweeper.name]) for part in busy]
    idle = [(part.sweeper.start, part.sweeper.radius) for part in parts if not len(part.path)]
    flown = crowd.together(ways, idle, scene.downwash)
    names = tuple(part.sweeper.name for part in busy)
    motions = {}
    for part, (motion, _) in zip(busy, flown, strict=True):
        if not own[part.sweeper.name].flies:
            motion[:, 3] = part.sweeper.start[2]
        motions[part.sweeper.name] = motion
    starts = np.array([motions[name][0, 1:] for name in names])
    homes = np.array([part.sweeper.start for part in busy])
    text = f"search: {dealt.text}"
    return [
        PlanTo(names, starts, True, "to the lanes of a search"),
        Fly(motions, instead=_stops(names, busy, flown), text=text),
        PlanTo(names, homes, True, "back from a search"),
    ]


def _way(part: Part, area: Ground, limits: Limits) -> crowd.Way:
    return crowd.Way(part.curve(area.free), limits, part.sweeper.radius)


def _stops(names: tuple[str, ...], parts: Sequence[Part], flown: Sequence[tuple[Motion, bool]]) -> tuple[PlanTo, ...]:
    """The corners of all ways, one after another: what is left where they cannot be flown on one clock."""
    ways = [part.path[::-1] if backwards else part.path for part, (_, backwards) in zip(parts, flown, strict=True)]
    count = min(MOST_STOPS, max(len(way) for way in ways))
    stops = []
    for k in range(1, count):
        places: Floats = np.array([way[min(k, len(way) - 1)] for way in ways])
        stops.append(PlanTo(names, places, True, f"searching lane by lane, {math.ceil(k / 2)}"))
    return tuple(stops)
