"""Formations: the places of each shape, held to the spacing, who takes which, and a formation goal as steps.

Offsets are metres forward, right, down of the shape's centre, as on the wire; places are ENU, as in the solver. All
distances are the downwash metric's, sqrt(dx² + dy² + (dz/c)²).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from agents.planner.goals import slots
from agents.planner.goals.moving import ROOM, SPARE, FormationMembers, move
from agents.planner.goals.steps import Fly, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.model.problem import COPTER, ROVER, Floats, Motion
from agents.planner.model.staticmap import StaticMap
from zmav import wire
from zmav.errors import BadInput

SHORT = 0.05
"""m: less is no way"""


def places(
    goal: wire.swarm.Formation, bodies: Sequence[wire.swarm.Body], downwash: float, rooms: Sequence[float] = ()
) -> Floats:
    """(N, 3) ENU: the shape's places about ``goal.at``, the first one its leader's.

    ``rooms``: m of each radius that are for what its position may be off. Raises :class:`BadInput` for numbers that are
    none, points that do not match the vehicles, and places nearer to each other than the vehicles may be.
    """
    offsets = offsets_of(goal, len(bodies))
    field = "points" if goal.shape == "custom" else "spacing"
    radii = [body.radius for body in bodies]
    check_apart(goal.vehicles, offsets, radii, downwash, labelled=goal.labelled, field=field, rooms=rooms)
    return placed(offsets, np.array(frames.enu(goal.at)), frames.course_of(goal.heading))


def placed(offsets: Floats, centre: Floats, course: float) -> Floats:
    """(N, 3) ENU of forward, right, down offsets about an ENU centre; ``course`` rad counter-clockwise from east."""
    ahead, right, down = offsets[:, 0], offsets[:, 1], offsets[:, 2]
    east = ahead * math.cos(course) + right * math.sin(course)
    north = ahead * math.sin(course) - right * math.cos(course)
    return np.column_stack((east, north, -down)) + centre


def offsets_of(goal: wire.swarm.Formation, count: int) -> Floats:
    """(N, 3) forward, right, down of the centre; neighbours ``goal.spacing`` apart (custom: as given)."""
    if goal.shape == "custom":
        if len(goal.points) != count:
            text = f"formation: {len(goal.points)} points for {count} vehicles"
            raise BadInput(text, field="points", value=len(goal.points), expected=f"{count} points")
        return np.array(goal.points, dtype=np.float64).reshape(-1, 3)
    if goal.points:
        text = f"formation: points are given for the shape {goal.shape}, which has its own"
        raise BadInput(text, field="points", value=len(goal.points), expected="none, or the shape custom")
    flat = SHAPES[goal.shape](count) * goal.spacing
    return np.column_stack((flat, np.zeros(count)))


def _wings(count: int) -> tuple[Floats, Floats]:
    """For each place its rank from the leader and its side: 0, then 1 right, 1 left, 2 right..."""
    index = np.arange(count)
    rank = (index + 1) // 2
    side = np.where(index == 0, 0.0, np.where(index % 2 == 1, 1.0, -1.0))
    return rank.astype(np.float64), side


def _line(count: int) -> Floats:
    rank, side = _wings(count)
    return np.column_stack((np.zeros(count), rank * side))


def _vee(count: int) -> Floats:
    """Wings swept back by 45 degrees."""
    rank, side = _wings(count)
    return np.column_stack((-rank, rank * side)) * math.sqrt(0.5)


def _column(count: int) -> Floats:
    return np.column_stack((-np.arange(count, dtype=np.float64), np.zeros(count)))


def _circle(count: int) -> Floats:
    """The first ahead, the others clockwise; the chord between neighbours is the spacing."""
    if count == 1:
        return np.zeros((1, 2))
    angle = np.arange(count) * math.tau / count
    return np.column_stack((np.cos(angle), np.sin(angle))) * (0.5 / math.sin(math.pi / count))


def _grid(count: int) -> Floats:
    """Rows from the front, as near to a square as it gets, about its middle; the last row is centred, too."""
    wide = math.ceil(math.sqrt(count))
    rows = math.ceil(count / wide)
    cells = []
    for row in range(rows):
        inside = min(wide, count - row * wide)
        cells += [((rows - 1) / 2.0 - row, column - (inside - 1) / 2.0) for column in range(inside)]
    return np.array(cells, dtype=np.float64)


SHAPES: dict[str, Callable[[int], Floats]] = {
    "line": _line,
    "vee": _vee,
    "column": _column,
    "circle": _circle,
    "grid": _grid,
}


def scaled_distances(some: Floats, others: Floats, downwash: float) -> Floats:
    """(N, M): the downwash metric's distances of (N, 3) from (M, 3) points; z counts 1 / ``downwash``."""
    scale = np.array([1.0, 1.0, 1.0 / downwash])
    distances: Floats = np.linalg.norm((some[:, None] - others[None]) * scale, axis=2)
    return distances


def check_apart(
    names: Sequence[str],
    points: Floats,
    radii: Sequence[float],
    downwash: float,
    *,
    labelled: bool,
    what: str = "formation",
    field: str = "spacing",
    rooms: Sequence[float] = (),
) -> None:
    """Raise :class:`BadInput` for places nearer than the vehicles may be, naming the worst pair.

    Labelled, the first vehicle has the first place; else any two may be neighbours, so the widest two must fit.
    ``rooms``: m of each radius that are for what the vehicle's position may be off.
    """
    if len(points) < 2:
        return
    reach = np.array(radii, dtype=np.float64)
    if labelled:
        need = reach[:, None] + reach[None]
    else:
        need = np.full((len(points), len(points)), float(np.sort(reach)[-2:].sum()))
    apart = scaled_distances(points, points, downwash)
    lack = need - apart
    np.fill_diagonal(lack, -np.inf)
    one, other = divmod(int(np.argmax(lack)), len(points))
    if lack[one, other] <= 1e-6:
        return
    one, other = min(one, other), max(one, other)
    whose = f"those of {names[one]} and {names[other]}" if labelled else f"number {one + 1} and number {other + 1}"
    text = (
        f"two places of the {what}, {whose}, are {apart[one, other]:.2f} m apart "
        f"(with the downwash factor {downwash:g}); these vehicles need {need[one, other]:.2f} m"
    )
    if rooms and (room := _of_two(rooms, one, other, labelled)) > 0.0:
        text += f", {room:.2f} m of them for what their positions may be off (--tight makes no room for that)"
    raise BadInput(
        text, field=field, value=round(float(apart[one, other]), 3), expected=f"{need[one, other]:.2f} m or more"
    )


def _of_two(rooms: Sequence[float], one: int, other: int, labelled: bool) -> float:
    return rooms[one] + rooms[other] if labelled else sum(sorted(rooms)[-2:])


def formation(
    goal: wire.swarm.Formation, views: Sequence[VehicleView], downwash: float, static: StaticMap
) -> list[Step]:
    """The steps of a formation: to its places by a plan.

    With ``via`` it forms up at the first of these places, looking along the way, and flies the others in shape, looking
    at the end where ``heading`` says.
    """
    slots.check_hovering(views, "formation")
    slots.check_flying(views, "formation")
    final = places(goal, [view.body for view in views], downwash, slots.rooms_of(views))
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
    radii, rooms = [view.body.radius for view in views], slots.rooms_of(views)
    check_apart(names, slotted, radii, downwash, labelled=True, rooms=rooms)
    up = PlanTo(names, slots.at_own_height(views, first[order]), True, f"forming a {text}")
    last = slots.at_own_height(views, placed(slotted, waypoints[-1], courses[1]))
    down = PlanTo(names, last, True, f"{text} to its end, not in shape")
    members = FormationMembers(slotted, np.array(radii), slots.limits_of(views))
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
