"""A search or a survey as steps: to where the lanes begin, all lanes on one clock, and back."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import shapely

from agents.planner.goals import slots, timing
from agents.planner.goals.curves import lengths_of
from agents.planner.goals.dealing import Ground, Part, Sweeper, seconds_of
from agents.planner.goals.drape import Drape
from agents.planner.goals.search import Split, ground, split
from agents.planner.goals.steps import Fly, Pictures, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.model.ground import NAME as GROUND
from agents.planner.model.ground import Floor
from agents.planner.model.problem import Floats, Motion, Path
from agents.planner.model.scene import Scene
from agents.planner.model.separation import separation
from zmav import wire
from zmav.errors import BadInput, Unsupported

MOST_STOPS = 200
"""places one after another, in which lanes are flown where they cannot be flown on one clock"""
DELAYS = np.arange(0.0, 61.0, 2.0)
"""s by which a vehicle sets out later, in the order in which they are tried"""
ALONG = 0.4
"""m of a lane that tell where it leads: the shortest there is has a little more"""
SPARE = 0.1
"""m more than the radii ask for, which hold what a vehicle may be off its way already"""


def search(
    goal: wire.swarm.Search, views: Sequence[VehicleView], scene: Scene, floor: Floor | None = None
) -> list[Step]:
    """The steps of a search; those for whom nothing is left stay where they are.

    Raises what :func:`agents.planner.goals.search.ground` and :func:`~agents.planner.goals.search.split` raise.
    """
    kind = kind_of(goal)
    slots.check_flying(views, kind)
    slots.check_hovering(views, kind)
    if isinstance(goal, wire.swarm.Survey) and (low := [view.name for view in views if not view.flies]):
        text = f"{', '.join(low)} cannot look down on the ground: leave rovers and boats out of a survey"
        raise Unsupported(text, field="vehicles", vehicles=low)
    sweepers = sweepers_of(goal, views)
    heights = (min(s.height for s in sweepers), max(s.height for s in sweepers))
    polygon = [(float(east), float(north)) for north, east in goal.polygon]
    drape: Drape | None = None
    if goal.above_ground:
        drape = Drape(goal.height, floor, polygon)
        heights = drape.heights
        sweepers = [replace(s, height=heights[1]) for s in sweepers]
        solid = [each for each in scene.obstacles if each.name != GROUND]
        scene = msgspec.structs.replace(scene, obstacles=solid)
    area = ground(polygon, scene, heights, max(s.radius for s in sweepers))
    if goal.lanes:
        return _steps(goal, _handed_on(goal, sweepers), area, scene, views, drape)
    course = None if goal.angle is None else frames.course_of(goal.angle)
    return _steps(goal, split(area, sweepers, goal.overlap, course), area, scene, views, drape)


def _handed_on(goal: wire.swarm.Search, sweepers: Sequence[Sweeper]) -> Split:
    """The ways that were left of a search, as they are told; who has them flies them at its own height."""
    if len(goal.lanes) != len(sweepers) or any(len(way) < 2 for way in goal.lanes):
        text = f"{len(goal.lanes)} ways over what is left for {len(sweepers)} vehicles, of two points or more each"
        raise BadInput(text, field="lanes", value=len(goal.lanes), expected=f"{len(sweepers)} ways")
    parts = []
    for sweeper, way in zip(sweepers, goal.lanes, strict=True):
        path = frames.enu_array(np.array(way, dtype=np.float64))
        path[:, 2] = sweeper.height
        parts.append(Part(sweeper, shapely.Polygon(), path, seconds_of(path, sweeper)))
    longest = max(part.seconds for part in parts)
    return Split(tuple(parts), 0.0, f"what is left of it in {longest:.0f} s")


def kind_of(goal: wire.swarm.Search) -> str:
    return str(type(goal).__struct_config__.tag)


def sweepers_of(goal: wire.swarm.Search, views: Sequence[VehicleView]) -> list[Sweeper]:
    """The vehicles as a search sees them, in the goal's order."""
    sweepers = []
    for view in views:
        body, (east, north, up) = view.body, frames.enu(view.pos_ned)
        height, width = goal.height, body.sweep_width
        if isinstance(goal, wire.swarm.Survey):
            height, width = goal.height - view.floor, goal.height * goal.camera[0]
        sweepers.append(
            Sweeper(
                name=view.name,
                start=np.array([east, north, up]),
                height=height if view.flies else up,
                width=width,
                speed=body.speed,
                accel=view.accel,
                climb=min(body.climb, body.descend),
                endurance=body.endurance,
                radius=body.radius,
            )
        )
    return sweepers


def _steps(
    goal: wire.swarm.Search,
    dealt: Split,
    area: Ground,
    scene: Scene,
    views: Sequence[VehicleView],
    drape: Drape | None,
) -> list[Step]:
    """To the lanes, over them, and back to where everybody was."""
    parts = dealt.parts
    if drape is not None:
        parts = tuple(replace(part, path=drape.over(part.path, rests=True)) for part in parts)
    busy = [part for part in parts if len(part.path)]
    limits = {view.name: slots.limits_of([view]) for view in views}
    own = {view.name: view for view in views}
    curves = [part.curve(area.free) for part in busy]
    curves = curves if drape is None else [drape.over(curve) for curve in curves]
    ways = [
        Way(curve, limits[part.sweeper.name], part.sweeper.radius) for part, curve in zip(busy, curves, strict=True)
    ]
    idle = [(part.sweeper.start, part.sweeper.radius) for part in parts if not len(part.path)]
    flown = together(ways, idle, scene.downwash)
    names = tuple(part.sweeper.name for part in busy)
    motions = {}
    for part, (motion, _) in zip(busy, flown, strict=True):
        if not own[part.sweeper.name].flies:
            motion[:, 3] = part.sweeper.start[2]
        motions[part.sweeper.name] = motion
    starts = np.array([motions[name][0, 1:] for name in names])
    homes = np.array([part.sweeper.start for part in busy])
    kind, figures = kind_of(goal), {part.sweeper.name: figures_of(goal, part) for part in busy}
    text = f"{kind}: {dealt.text}{_pictures(goal, figures)}"
    pictures = {name: pictures_of(goal, motions[name]) for name in names} if isinstance(goal, wire.swarm.Survey) else {}
    return [
        PlanTo(names, starts, True, f"to the lanes of a {kind}"),
        Fly(motions, _stops(names, busy, flown), text, figures, pictures),
        PlanTo(names, homes, True, f"back from a {kind}"),
    ]


def figures_of(goal: wire.swarm.Search, part: Part) -> dict[str, float]:
    """One vehicle's part: ``seconds`` and ``metres`` there, over the lanes and back, the share of a full
    ``battery`` that it takes by the vehicle's ``endurance``, and of a survey its ``pictures``.
    """
    start, path = part.sweeper.start[None], part.path
    whole = float(lengths_of(np.vstack((start, path, start)))[-1])
    figures = {"seconds": part.seconds, "metres": whole, "battery": part.seconds / part.sweeper.endurance}
    if isinstance(goal, wire.swarm.Survey):
        figures["pictures"] = math.ceil(float(lengths_of(path)[-1]) / spacing_of(goal)) + 1
    return figures


def spacing_of(goal: wire.swarm.Survey) -> float:
    """m from one picture to the next along the way."""
    return goal.height * goal.camera[1] * (1.0 - goal.front)


def pictures_of(goal: wire.swarm.Survey, motion: Motion) -> Pictures:
    """It begins with a lane, and all lanes are parallel."""
    moved = np.linalg.norm(motion[:, 1:3] - motion[0, 1:3], axis=1)
    east, north = (motion[int(np.argmax(moved > ALONG)), 1:3] - motion[0, 1:3]).tolist()
    return Pictures(spacing_of(goal) if goal.trigger else 0.0, math.atan2(east, north))


def _pictures(goal: wire.swarm.Search, figures: Mapping[str, Mapping[str, float]]) -> str:
    """How many pictures, how far apart, and how fine."""
    if not isinstance(goal, wire.swarm.Survey):
        return ""
    count = sum(each["pictures"] for each in figures.values())
    text = f"; {count:.0f} pictures, one every {spacing_of(goal):.1f} m"
    text += f", {100.0 * goal.height * goal.camera[0] / goal.pixels:.1f} cm a pixel" if goal.pixels else ""
    return text + ("" if goal.trigger else "; the cameras are not triggered")


def _stops(names: tuple[str, ...], parts: Sequence[Part], flown: Sequence[tuple[Motion, bool]]) -> tuple[PlanTo, ...]:
    """The corners of all ways, one after another: what is left where they cannot be flown on one clock."""
    ways = [part.path[::-1] if backwards else part.path for part, (_, backwards) in zip(parts, flown, strict=True)]
    count = min(MOST_STOPS, max(len(way) for way in ways))
    stops = []
    for k in range(1, count):
        places: Floats = np.array([way[min(k, len(way) - 1)] for way in ways])
        stops.append(PlanTo(names, places, True, f"searching lane by lane, {math.ceil(k / 2)}"))
    return tuple(stops)


# Several ways through one area flown at once: in which direction, and how much later each goes.


@dataclass(frozen=True)
class Way:
    """A way that is to be flown, its corners rounded already."""

    curve: Path
    limits: timing.Limits
    """of this vehicle alone: (1,) each"""
    radius: float


def together(ways: Sequence[Way], idle: Sequence[tuple[Floats, float]], downwash: float) -> list[tuple[Motion, bool]]:
    """Motions from t = 0, and whether each goes backwards, that keep apart from each other, and from ``idle`` others
    (place, radius), which stand.

    The longest is placed first, each of the others as soon as it may: forwards or backwards, then later. A way for
    which nothing helps is flown as it is, for the verifier to find.
    """
    plain = [motion_of(way) for way in ways]
    standing = [(np.array([[0.0, *place]]), radius) for place, radius in idle]
    found: dict[int, tuple[Motion, bool]] = {}
    for i in sorted(range(len(ways)), key=lambda k: -plain[k][-1, 0]):
        others = standing + [(found[k][0], ways[k].radius) for k in found]
        found[i] = _place(ways[i], plain[i], others, downwash)
    return [found[i] for i in range(len(ways))]


def motion_of(way: Way) -> Motion:
    return np.ascontiguousarray(timing.fly(way.curve[:, None, :], way.limits)[:, 0])


def _place(way: Way, plain: Motion, others: list[tuple[Motion, float]], downwash: float) -> tuple[Motion, bool]:
    back = motion_of(Way(way.curve[::-1], way.limits, way.radius))
    for delay, backwards in itertools.product(DELAYS, (False, True)):
        motion = shifted(back if backwards else plain, float(delay))
        if all(separation(motion, other, downwash)[0] >= way.radius + radius + SPARE for other, radius in others):
            return motion, backwards
    return plain, False


def shifted(motion: Motion, delay: float) -> Motion:
    """The motion so much later; it stands at its first place until then."""
    moved: Motion = motion + np.array([delay, 0.0, 0.0, 0.0])
    return np.vstack(([0.0, *moved[0, 1:]], moved)) if delay > 0.0 else moved
