"""A search goal as steps: to where the lanes begin, all lanes on one clock, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agents.planner.goals import crowd, slots
from agents.planner.goals.dealing import Part, Sweeper
from agents.planner.goals.search import Ground, Split, ground, split
from agents.planner.goals.steps import Fly, Loiter, PlanTo, Step, VehicleView
from agents.planner.goals.timing import Limits
from agents.planner.live import frames
from agents.planner.problem import Floats
from agents.planner.scene import Scene
from zmav import wire

LAYER_GAP = 2.0
"""m beyond what they need, between the heights of planes"""
MOST_STOPS = 200
"""places one after another, in which lanes are flown where they cannot be flown on one clock"""


def search(goal: wire.swarm.Search, views: Sequence[VehicleView], scene: Scene) -> list[Step]:
    """The steps of a search; those for whom nothing is left stay where they are.

    Planes sweep above all others, each at a height of its own, for they keep to no clock. Raises what
    :func:`agents.planner.goals.search.ground` and :func:`~agents.planner.goals.search.split` raise.
    """
    slots.check_flying(views, "search")
    sweepers = sweepers_of(goal, views, scene.downwash)
    heights = (min(s.height for s in sweepers), max(s.height for s in sweepers))
    polygon = [(float(east), float(north)) for north, east in goal.polygon]
    area = ground(polygon, scene, heights, max(s.radius for s in sweepers))
    course = None if goal.angle is None else frames.course_of(goal.angle)
    dealt = split(area, sweepers, goal.overlap, course)
    steps: list[Step] = []
    winged = [part for part in dealt.parts if part.sweeper.turn_radius > 0.0 and len(part.path)]
    if winged:
        steps.append(_planes(winged, dealt))
    hovering = [part for part in dealt.parts if part.sweeper.turn_radius <= 0.0]
    return steps + _copters(hovering, dealt, area, scene, views)


def sweepers_of(goal: wire.swarm.Search, views: Sequence[VehicleView], downwash: float) -> list[Sweeper]:
    """The vehicles as a search sees them, in the goal's order; each a layer above the one before it."""
    sweepers = []
    above = goal.height + goal.layer * len(views)
    for i, view in enumerate(views):
        body = view.body
        east, north, up = frames.enu(view.pos_ned)
        height = goal.height + i * goal.layer if view.flies else up
        if not view.hovers:
            above += 2.0 * body.radius * downwash + LAYER_GAP
            height = above
        turn = 0.0 if view.hovers else body.turn_radius or body.speed**2 / body.accel
        sweepers.append(
            Sweeper(
                name=view.name, start=np.array([east, north, up]), height=height, width=body.sweep_width,
                speed=body.speed, accel=body.accel, climb=min(body.climb, body.descend), endurance=body.endurance,
                radius=body.radius, turn_radius=turn,
            )
        )  # fmt: skip
    return sweepers


def _planes(parts: Sequence[Part], dealt: Split) -> Loiter:
    """Over the ends of its lanes in turn, then around the last one."""
    return Loiter(
        vehicles=tuple(part.sweeper.name for part in parts),
        centres=np.array([part.path[-1] for part in parts]),
        radii=np.array([part.sweeper.turn_radius for part in parts]),
        via={part.sweeper.name: part.path for part in parts},
        text=f"search: {dealt.text}",
    )


def _copters(
    parts: Sequence[Part], dealt: Split, area: Ground, scene: Scene, views: Sequence[VehicleView]
) -> list[Step]:
    """To the lanes, over them, and back to where everybody was."""
    busy = [part for part in parts if len(part.path)]
    if not busy:
        return []
    limits = {view.name: slots.limits_of([view]) for view in views}
    own = {view.name: view for view in views}
    ways = [_way(part, area, limits[part.sweeper.name]) for part in busy]
    idle = [(part.sweeper.start, part.sweeper.radius) for part in parts if not len(part.path)]
    top = scene.bounds.max[2] if scene.geofence is None else scene.geofence.ceiling
    flown = crowd.together(ways, idle, scene.downwash, top)
    names = tuple(part.sweeper.name for part in busy)
    motions = {}
    for part, each in zip(busy, flown, strict=True):
        if not own[part.sweeper.name].flies:
            each.motion[:, 3] = part.sweeper.start[2]
        motions[part.sweeper.name] = each.motion
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


def _stops(names: tuple[str, ...], parts: Sequence[Part], flown: Sequence[crowd.Flown]) -> tuple[PlanTo, ...]:
    """The corners of all ways, one after another: what is left where they cannot be flown on one clock."""
    ways = [
        (part.path[::-1] if each.backwards else part.path) + np.array([0.0, 0.0, each.lift])
        for part, each in zip(parts, flown, strict=True)
    ]
    count = min(MOST_STOPS, max(len(way) for way in ways))
    stops = []
    for k in range(1, count):
        places: Floats = np.array([way[min(k, len(way) - 1)] for way in ways])
        stops.append(PlanTo(names, places, True, f"searching lane by lane, {math.ceil(k / 2)}"))
    return tuple(stops)
