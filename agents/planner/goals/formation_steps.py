"""A formation goal as steps: form up, fly in shape, or go from shape to shape by plans where that cannot be done."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from agents.planner.goals import slots
from agents.planner.goals.formation import check_apart, offsets_of, placed, places
from agents.planner.goals.moving import ROOM, SPARE, FormationMembers, Moved, move
from agents.planner.goals.patrol import Finder
from agents.planner.goals.steps import Fly, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.model.geometry import World
from agents.planner.model.problem import COPTER, ROVER, Floats, Path
from agents.planner.model.staticmap import StaticMap
from zmav import wire
from zmav.errors import BadInput

IN_SHAPE = 0.5
"""m: vehicles that are all as near to a shape's places stand in it"""
SHORT = 0.05
"""m, and rad: less is no move"""


def formation(
    goal: wire.swarm.Formation, views: Sequence[VehicleView], downwash: float, static: StaticMap
) -> list[Step]:
    """The steps of a formation.

    With ``via`` it forms up at the first of these places, looking along the way, and flies the others in shape, looking
    at the end where ``heading`` says. Vehicles that stand in the shape already move in it, too. Without either they
    go to their places by a plan.
    """
    slots.check_hovering(views, "formation")
    slots.check_flying(views, "formation")
    if goal.shape == "sphere" and not all(view.flies for view in views):
        wheels = [view.name for view in views if not view.flies]
        text = f"{', '.join(wheels)} cannot leave the ground for a sphere; choose a flat shape"
        raise BadInput(text, field="shape", value=goal.shape, expected="line, vee, column, circle, grid or custom")
    bodies = [view.body for view in views]
    final = places(goal, bodies, downwash)
    offsets = offsets_of(goal, len(views), downwash)
    names = tuple(view.name for view in views)
    text = f"{goal.shape} of {len(views)}"
    standing = slots.standing_in(offsets, views, IN_SHAPE, goal.labelled)
    if standing is None and not goal.via:
        if goal.labelled or not all(view.flies for view in views):
            order = list(range(len(views))) if goal.labelled else slots.choose(views, final)
            return [PlanTo(names, slots.at_own_height(views, final[order]), True, f"forming a {text}")]
        return [PlanTo(names, final, False, f"forming a {text}")]
    course = frames.course_of(goal.heading)
    if standing is not None:
        order, centre, begin = standing
        waypoints = [centre, *(np.array(frames.enu(point)) for point in (*goal.via, goal.at))]
        courses: tuple[float | None, float] = (begin, course)
    else:
        waypoints = [np.array(frames.enu(point)) for point in (*goal.via, goal.at)]
        courses = (None, course)
        order = []
    return _in_shape(views, offsets, order, waypoints, courses, downwash, static, text)


def _in_shape(
    views: Sequence[VehicleView],
    offsets: Floats,
    order: list[int],
    waypoints: list[Floats],
    courses: tuple[float | None, float],
    downwash: float,
    static: StaticMap,
    text: str,
) -> list[Step]:
    """Form up where the centre's way begins, then fly it; ``order`` is empty where slots are still to be dealt out."""
    names = tuple(view.name for view in views)
    begin = _first_course(waypoints, courses)
    first = placed(offsets, waypoints[0], begin)
    order = order or slots.choose(views, first)
    slotted = offsets[order]
    check_apart(names, slotted, [view.body.radius for view in views], downwash, labelled=True)
    up = PlanTo(names, slots.at_own_height(views, first[order]), True, f"forming a {text}")
    last = slots.at_own_height(views, placed(slotted, waypoints[-1], courses[1]))
    down = PlanTo(names, last, True, f"{text} to its end, not in shape")
    still = math.dist(waypoints[0], waypoints[-1]) < SHORT and len(waypoints) == 2
    if still and abs(math.remainder(begin - courses[1], math.tau)) < SHORT:
        return [up]
    members = FormationMembers(slotted, slots.radii_of(views), slots.limits_of(views), downwash)
    moved = best_move(waypoints, (begin, courses[1]), members, static.world, finder(views, members, static))
    if moved is None:
        return [up, down]
    motions = {}
    for view, motion in zip(views, moved.motions, strict=True):
        if not view.flies:
            motion[:, 3] = -view.pos_ned[2]
        motions[view.name] = motion
    return [up, Fly(motions, instead=(down,), text=f"{text} on its way")]


def _first_course(waypoints: list[Floats], courses: tuple[float | None, float]) -> float:
    if courses[0] is not None:
        return courses[0]
    for here, there in itertools.pairwise(waypoints):
        if math.dist(here[:2], there[:2]) > SHORT:
            return math.atan2(there[1] - here[1], there[0] - here[0])
    return courses[1]


def finder(views: Sequence[VehicleView], members: FormationMembers, static: StaticMap) -> list[Finder]:
    """Ways for the shape's centre: with room for the whole shape, then for its widest vehicle alone."""
    rover = all(not view.flies for view in views)
    kind = ROVER if rover else COPTER
    wide = float(members.radii.max()) + SPARE

    def find(room: float) -> Finder:
        return lambda here, there: static.path(here, there, wide, kind, room=room)

    return [find(members.extent + ROOM), find(ROOM)]


def best_move(
    waypoints: list[Floats],
    courses: tuple[float | None, float | None],
    members: FormationMembers,
    world: World | None,
    finders: Sequence[Finder],
) -> Moved | None:
    """The quickest flight in shape along the waypoints, of all finders' ways; None where there is none."""
    moves = []
    for way in _ways(waypoints, finders):
        moved = move(way, courses, members, world)
        if moved is None:
            continue
        moves.append(moved)
        if len(moves) == 1 and not moved.squeezed.any():
            break  # straight, and in shape all the way
    return min(moves, key=lambda each: each.makespan, default=None)


def _ways(waypoints: list[Floats], finders: Sequence[Finder]) -> Iterator[Path]:
    """The straight way first, then what each finder finds."""
    yield np.array(waypoints, dtype=np.float64)
    for find in finders:
        legs: list[Path] = []
        for here, there in itertools.pairwise(waypoints):
            leg = find(here, there) if math.dist(here, there) > 1e-6 else np.array([here, there])
            if leg is None:
                break
            legs.append(leg)
        else:
            yield np.concatenate(legs)
