"""A formation goal as steps: form up, fly in shape, or go from shape to shape by plans where that cannot be done."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from agents.planner.goals import slots
from agents.planner.goals.formation import check_apart, offsets_of, placed, places
from agents.planner.goals.moving import ROOM, SPARE, FormationMembers, move
from agents.planner.goals.steps import Fly, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.model.problem import COPTER, ROVER, Floats, Motion
from agents.planner.model.staticmap import StaticMap
from zmav import wire

SHORT = 0.05
"""m: less is no way"""


def formation(
    goal: wire.swarm.Formation, views: Sequence[VehicleView], downwash: float, static: StaticMap
) -> list[Step]:
    """The steps of a formation: to its places by a plan.

    With ``via`` it forms up at the first of these places, looking along the way, and flies the others in shape, looking
    at the end where ``heading`` says.
    """
    slots.check_hovering(views, "formation")
    slots.check_flying(views, "formation")
    final = places(goal, [view.body for view in views], downwash)
    names, text = tuple(view.name for view in views), f"{goal.shape} of {len(views)}"
    if goal.via:
        return _in_shape(goal, views, downwash, static, text)
    if goal.labelled or not all(view.flies for view in views):
        order = list(range(len(views))) if goal.labelled else slots.choose(views, final)
        return [PlanTo(names, slots.at_own_height(views, final[order]), True, f"forming a {text}")]
    return [PlanTo(names, final, False, f"forming a {text}")]


def _in_shape(
    goal: wire.swarm.Formation, views: Sequence[VehicleView], downwash: float, static: StaticMap, text: str
) -> list[Step]:
    """Form up where the centre's way begins, then fly it."""
    names, offsets = tuple(view.name for view in views), offsets_of(goal, len(views))
    waypoints = [np.array(frames.enu(point)) for point in (*goal.via, goal.at)]
    courses = _first_course(waypoints, frames.course_of(goal.heading)), frames.course_of(goal.heading)
    first = placed(offsets, waypoints[0], courses[0])
    order = slots.choose(views, first)
    slotted = offsets[order]
    check_apart(names, slotted, [view.body.radius for view in views], downwash, labelled=True)
    up = PlanTo(names, slots.at_own_height(views, first[order]), True, f"forming a {text}")
    last = slots.at_own_height(views, placed(slotted, waypoints[-1], courses[1]))
    down = PlanTo(names, last, True, f"{text} to its end, not in shape")
    members = FormationMembers(slotted, slots.radii_of(views), slots.limits_of(views))
    moved = _moved(waypoints, courses, members, views, static)
    if moved is None:
        return [up, down]
    motions = {}
    for view, motion in zip(views, moved, strict=True):
        if not view.flies:
            motion[:, 3] = -view.pos_ned[2]
        motions[view.name] = motion
    return [up, Fly(motions, instead=(down,), text=f"{text} on its way")]


def _first_course(waypoints: list[Floats], otherwise: float) -> float:
    """Along the way, where that is level somewhere."""
    for here, there in itertools.pairwise(waypoints):
        if math.dist(here[:2], there[:2]) > SHORT:
            return math.atan2(there[1] - here[1], there[0] - here[0])
    return otherwise


def _moved(
    waypoints: list[Floats],
    courses: tuple[float, float],
    members: FormationMembers,
    views: Sequence[VehicleView],
    static: StaticMap,
) -> list[Motion] | None:
    """In shape straight along the waypoints, else by ways with room for the whole shape; None where there is none."""
    straight = np.array(waypoints, dtype=np.float64)
    if (moved := move(straight, courses, members, static.world)) is not None:
        return moved
    kind = COPTER if any(view.flies for view in views) else ROVER
    wide, legs = float(members.radii.max()) + SPARE, [straight[:1]]
    for here, there in itertools.pairwise(waypoints):
        if math.dist(here, there) > 1e-6:
            leg = static.path(here, there, wide, kind, room=members.extent + ROOM)
            if leg is None:
                return None
            legs.append(leg)
    return move(np.concatenate(legs), courses, members, static.world)
