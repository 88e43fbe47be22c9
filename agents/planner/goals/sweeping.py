"""A search goal as steps: to where the lanes begin, all lanes on one clock, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from agents.planner.goals import crowd, slots
from agents.planner.goals.dealing import Part, Sweeper
from agents.planner.goals.search import Ground, Split, ground, split
from agents.planner.goals.steps import Fly, Loiter, PlanTo, Step, VehicleView
from agents.planner.goals.timing import Limits
from agents.planner.live import frames
from agents.planner.model.problem import Floats, Path
from agents.planner.model.scene import Scene
from agents.planner.solve.loiter import STEADY, goes_first
from zmav import wire
from zmav.errors import BadInput
from zmav.wire.swarm import Body

MOST_STOPS = 200
"""places one after another, in which lanes are flown where they cannot be flown on one clock"""


def search(goal: wire.swarm.Search, views: Sequence[VehicleView], scene: Scene) -> list[Step]:
    """The steps of a search; those for whom nothing is left stay where they are.

    Planes sweep above all others, each at a height of its own, for they keep to no clock: the higher one is now, the
    higher it sweeps, so that none has to pass another. Raises what
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
        steps.append(_planes(winged, dealt, area, {view.name: view.body for view in views}, scene.downwash))
    hovering = [part for part in dealt.parts if part.sweeper.turn_radius <= 0.0]
    return steps + _copters(hovering, dealt, area, scene, views)


def sweepers_of(goal: wire.swarm.Search, views: Sequence[VehicleView], downwash: float) -> list[Sweeper]:
    """The vehicles as a search sees them, in the goal's order; each a layer above the one before it."""
    sweepers = []
    layers = _layers(goal, views, downwash)
    for i, view in enumerate(views):
        body = view.body
        east, north, up = frames.enu(view.pos_ned)
        height = goal.height + i * goal.layer if view.flies else up
        height = layers.get(view.name, height)
        turn = 0.0 if view.hovers else body.turn_radius or body.speed**2 / body.accel
        sweepers.append(
            Sweeper(
                name=view.name,
                start=np.array([east, north, up]),
                height=height,
                width=body.sweep_width,
                speed=body.speed,
                accel=body.accel,
                climb=min(body.climb, body.descend),
                endurance=body.endurance,
                radius=body.radius,
                turn_radius=turn,
            )
        )
    return sweepers


def _layers(goal: wire.swarm.Search, views: Sequence[VehicleView], downwash: float) -> dict[str, float]:
    """The planes' heights, above everybody else's, in the order in which they are above each other now."""
    layers, above = {}, goal.height + goal.layer * max(0, len(views) - 1)
    below = max((view.body.radius for view in views if view.hovers), default=0.0)
    for view in sorted((view for view in views if not view.hovers), key=lambda view: (-view.pos_ned[2], view.name)):
        above += downwash * (below + view.body.radius) + 2.0 * STEADY
        layers[view.name], below = above, view.body.radius
    return layers


def _planes(parts: Sequence[Part], dealt: Split, area: Ground, bodies: Mapping[str, Body], downwash: float) -> Loiter:
    """Over its lanes in turn, then in a circle as near to the end of the last one as there is room.

    The points it flies by are a turn's radius beyond each lane's ends, where it turns before it comes to them.
    """
    first = {}
    for one in parts:
        name, now = one.sweeper.name, (float(one.sweeper.start[2]), one.sweeper.height)
        first[name] = tuple(
            other.sweeper.name
            for other in parts
            if other is not one
            and goes_first(
                (float(other.sweeper.start[2]), other.sweeper.height),
                now,
                downwash * (bodies[name].radius + bodies[other.sweeper.name].radius) + 2.0 * STEADY,
            )
        )
    return Loiter(
        vehicles=tuple(part.sweeper.name for part in parts),
        centres=np.array([_circle_near(part, area) for part in parts]),
        radii=np.array([part.sweeper.turn_radius for part in parts]),
        speeds=np.array([part.sweeper.speed for part in parts]),
        via={part.sweeper.name: _beyond(part, dealt.course) for part in parts},
        first=first,
        text=f"search: {dealt.text}",
    )


def _circle_near(part: Part, area: Ground) -> Floats:
    """(3,) ENU centre of a circle, nearest to the part's end; raises :class:`BadInput` where none has room."""
    sweeper = part.sweeper
    room = area.free.buffer(-sweeper.turn_radius)
    if room.is_empty:
        text = (
            f"search: {sweeper.name} has no room at {sweeper.height:.0f} m to circle with {sweeper.turn_radius:.0f} m"
        )
        raise BadInput(text, field="vehicles", value=sweeper.name, expected="more room, or vehicles that hover")
    nearest = shapely.shortest_line(room, shapely.Point(part.path[-1, :2]))
    return np.array([*shapely.get_coordinates(nearest)[0], sweeper.height])


def _beyond(part: Part, course: float) -> Path:
    """The part's way with its lanes, which run along ``course``, longer at both ends by the turn's radius."""
    path = part.path.copy()
    along = np.array([math.cos(course), math.sin(course)])
    k = 0
    while k < len(path) - 1:
        piece = part.path[k + 1, :2] - part.path[k, :2]
        far = float(piece @ along)
        if abs(far) > 1e-6 and float(np.linalg.norm(piece - far * along)) < 1e-6 * max(1.0, abs(far)):
            reach = math.copysign(part.sweeper.turn_radius, far) * along
            path[k, :2] -= reach
            path[k + 1, :2] += reach
            k += 1
        k += 1
    return path


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


def _stops(names: tuple[str, ...], parts: Sequence[Part], flown: Sequence[crowd.DirectedWay]) -> tuple[PlanTo, ...]:
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
