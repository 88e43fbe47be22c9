"""Formations as geometry: the places of each shape, held to the spacing, and who takes which.

Offsets are metres forward, right, down of the shape's centre, as on the wire; places are ENU, as in the solver. All
distances are the downwash metric's, sqrt(dx² + dy² + (dz/c)²).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from agents.planner.live import frames
from agents.planner.model.problem import Floats
from zmav import wire
from zmav.errors import BadInput


def places(goal: wire.swarm.Formation, bodies: Sequence[wire.swarm.Body], downwash: float) -> Floats:
    """(N, 3) ENU: the shape's places about ``goal.at``, the first one its leader's.

    Raises :class:`BadInput` for numbers that are none, points that do not match the vehicles, and places nearer to
    each other than the vehicles may be.
    """
    offsets = offsets_of(goal, len(bodies))
    field = "points" if goal.shape == "custom" else "spacing"
    radii = [body.radius for body in bodies]
    check_apart(goal.vehicles, offsets, radii, downwash, labelled=goal.labelled, field=field)
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
) -> None:
    """Raise :class:`BadInput` for places nearer than the vehicles may be, naming the worst pair.

    Labelled, the first vehicle has the first place; else any two may be neighbours, so the widest two must fit.
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
    raise BadInput(
        text, field=field, value=round(float(apart[one, other]), 3), expected=f"{need[one, other]:.2f} m or more"
    )
