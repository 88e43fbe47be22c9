"""Scenes (``swarm-scene/1``): vehicles with starts and goals in a world of obstacles, as a JSON file or made live.

Local ENU metres, z up, angles of headings in degrees counter-clockwise from east. Fields that this version does not
know are left alone everywhere: files say more of themselves than a planner needs.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from agents.planner.model.errors import PlanError

Point = tuple[float, float, float]
Corner = tuple[float, float]
FORMAT = "swarm-scene/1"
LARGEST = 1 << 28
"""bytes of a file: a device may have no end"""
FARTHEST = 1e7
"""m from the origin; what is not of this earth makes arithmetic overflow"""
LEAST, MOST = 1e-3, 1e5
"""of radii, speeds and accelerations; the least of a downwash, too, and its inverse the most"""


class Vehicle(msgspec.Struct, kw_only=True):
    """One vehicle; metres, m/s, m/s² (the norm of the vector in three dimensions).

    Planes start and end flying, and leave the scene after their last sample; rovers stay at their start's height.
    """

    id: str
    type: Literal["copter", "rover", "plane"]
    start: Point
    goal: Point | None = None
    """None where the scene's ``goals`` are anybody's (unlabelled)"""
    radius: float
    vmax: float
    amax: float
    vz_up: float | None = None
    vz_down: float | None = None
    vmin: float | None = None
    """planes only"""
    start_heading_deg: float | None = None
    """planes only"""


class Box(msgspec.Struct, kw_only=True, tag="box", omit_defaults=True):
    min: Point
    max: Point
    name: str = ""
    """what errors call it; its kind and number where it has none"""


class Cylinder(msgspec.Struct, kw_only=True, tag="cylinder", omit_defaults=True):
    center: Corner
    radius: float
    floor: float
    ceiling: float
    name: str = ""


class NoFly(msgspec.Struct, kw_only=True, tag="no_fly", omit_defaults=True):
    """A prism: any simple polygon, either way round."""

    polygon: list[Corner]
    floor: float
    ceiling: float
    name: str = ""


Obstacle = Box | Cylinder | NoFly
"""a centre stays a vehicle's ``radius`` away from each"""


class Bounds(msgspec.Struct, kw_only=True):
    """The centre stays inside."""

    min: Point
    max: Point


class Fence(msgspec.Struct, kw_only=True):
    """The centre stays inside."""

    polygon: list[Corner]
    floor: float
    ceiling: float


class Scene(msgspec.Struct, kw_only=True):
    """What is to be planned."""

    format: str = FORMAT
    name: str = ""
    vehicles: list[Vehicle]
    assignment: Literal["labelled", "unlabelled"] = "labelled"
    goals: list[Point] | None = None
    """unlabelled: one for each vehicle, whichever gets it"""
    obstacles: list[Obstacle] = []
    bounds: Bounds
    geofence: Fence | None = None
    downwash: float = 1.0
    """c: two vehicles keep sqrt(dx² + dy² + (dz/c)²) >= r_i + r_j at every instant"""
    goal_tolerance: float = 0.5
    time_limit: float | None = None
    """s by which the last trajectory ends; None: none"""
    lower_bound: dict[str, Any] | None = None


def extent_of(obstacle: Obstacle) -> tuple[Point, Point]:
    """The corners of the box around it: least x, y, z, and greatest."""
    if isinstance(obstacle, Box):
        return obstacle.min, obstacle.max
    if isinstance(obstacle, Cylinder):
        (x, y), r = obstacle.center, obstacle.radius
        return (x - r, y - r, obstacle.floor), (x + r, y + r, obstacle.ceiling)
    xs, ys = zip(*obstacle.polygon, strict=True)
    return (min(xs), min(ys), obstacle.floor), (max(xs), max(ys), obstacle.ceiling)


def name_of(scene: Scene, obstacle: int) -> str:
    """What to call an obstacle: by its name, or its kind and its place among the obstacles (from 0)."""
    each = scene.obstacles[obstacle]
    if each.name:
        return each.name
    kind = "no-fly zone" if isinstance(each, NoFly) else type(each).__name__.lower()
    return f"{kind} {obstacle}"


def read_scene(path: str | Path, largest: int = LARGEST) -> Scene:
    """The scene of a file. Raises :class:`PlanError` (``invalid_scene``) that names the field and what is wrong."""
    try:
        return parse_scene(read_file(path, largest))
    except OSError as e:
        raise PlanError("invalid_scene", [], f"cannot read {path}: {e.strerror}") from e


def read_file(path: str | Path, largest: int = LARGEST) -> bytes:
    """What is in a text file, without a byte order mark. Raises :class:`OSError`, also for more than ``largest``."""
    with Path(path).open("rb") as file:
        data = file.read(largest + 1)
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"it has more than {largest >> 20} MB")
    return data.removeprefix(b"\xef\xbb\xbf")


def parse_scene(data: bytes) -> Scene:
    """The scene in a JSON document, its polygons without repeated corners. Raises as :func:`read_scene` does."""
    try:
        scene = msgspec.json.decode(data, type=Scene)
    except msgspec.ValidationError as e:
        raise PlanError("invalid_scene", _named_in(data, str(e)), _said(str(e))) from e
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise PlanError("invalid_scene", [], f"this is no JSON: {e}") from e
    scene = _opened(scene)
    check(scene)
    return scene


def _said(text: str) -> str:
    """msgspec's words, with the field first."""
    what, at, where = text.partition(" - at `$")
    return f"{where.rstrip('`').lstrip('.') or 'the scene'}: {what}" if at else f"the scene: {what}"


def _named_in(data: bytes, text: str) -> list[str]:
    """The id of the vehicle that a message of msgspec's is about, where it is about one that has one."""
    _, at, rest = text.partition("$.vehicles[")
    number, _, _ = rest.partition("]")
    try:
        name = msgspec.json.decode(data)["vehicles"][int(number)]["id"] if at else None
    except (msgspec.DecodeError, LookupError, TypeError, ValueError, RecursionError):
        return []
    return [name] if isinstance(name, str) else []


def _opened(scene: Scene) -> Scene:
    """Each polygon without corners that repeat the one before, or the first at the end."""
    for each in (*scene.obstacles, *([scene.geofence] if scene.geofence else [])):
        if isinstance(each, NoFly | Fence):
            each.polygon = open_ring(each.polygon) or each.polygon[:1]
    return scene


def check(scene: Scene) -> None:
    """Whether a scene makes sense by itself. Raises :class:`PlanError` (``invalid_scene``) for the first that does not.

    What is in the way of what is :func:`agents.planner.model.validate.validate`'s to say.
    """
    if scene.format != FORMAT:
        raise PlanError("invalid_scene", [], f"format: {scene.format!r} is not known, {FORMAT!r} is")
    for problem in _wrong_with_scene(scene):
        raise PlanError("invalid_scene", [], problem)
    seen: set[str] = set()
    twice = [v.id for v in scene.vehicles if v.id in seen or seen.add(v.id)]  # type: ignore[func-returns-value]
    if twice:
        raise PlanError("invalid_scene", dict.fromkeys(twice), f"vehicles: more than one is called {twice[0]!r}")
    for k, vehicle in enumerate(scene.vehicles):
        for problem in _wrong_with_vehicle(vehicle):
            raise PlanError("invalid_scene", [vehicle.id], f"vehicles[{k}] ({vehicle.id}): {problem}")
    if scene.assignment == "labelled":
        without = [v.id for v in scene.vehicles if v.goal is None]
        if without:
            raise PlanError("invalid_scene", without, f"goal: {', '.join(without)} have none in a labelled scene")
    for k, obstacle in enumerate(scene.obstacles):
        for problem in _wrong_with_obstacle(obstacle):
            raise PlanError("invalid_scene", [], f"obstacles[{k}]: {problem}")


def _wrong_with_scene(scene: Scene) -> Iterator[str]:
    if not scene.vehicles:
        yield "vehicles: there is none"
    yield from _span("bounds: min and max", scene.bounds.min, scene.bounds.max)
    if not LEAST <= scene.downwash <= 1.0 / LEAST:
        yield f"downwash: {scene.downwash} is not between {LEAST} and {1.0 / LEAST:g}"
    if not (math.isfinite(scene.goal_tolerance) and scene.goal_tolerance >= 0.0):
        yield f"goal_tolerance: {scene.goal_tolerance} is no distance"
    if scene.time_limit is not None and not scene.time_limit > 0.0:
        yield f"time_limit: {scene.time_limit} is not positive"
    if scene.geofence is not None:
        yield from (f"geofence: {problem}" for problem in _wrong_with_prism(scene.geofence))
    if scene.assignment == "unlabelled":
        goals, count = scene.goals, len(scene.vehicles)
        if goals is None or len(goals) != count:
            yield f"goals: {len(goals or [])} for {count} vehicles; an unlabelled scene has one for each"
        for k, goal in enumerate(goals or []):
            if not all(map(_near, goal)):
                yield f"goals[{k}]: {goal} is no place"


def _wrong_with_vehicle(v: Vehicle) -> Iterator[str]:
    if not v.id:
        yield "id: it is empty"
    for name in ("radius", "vmax", "amax", "vz_up", "vz_down", "vmin"):
        value = getattr(v, name)
        if value is not None and not (LEAST <= value <= MOST or (name == "vmin" and value == 0.0)):
            yield f"{name}: {value} is not between {LEAST} and {MOST:g}"
    for name in ("start", "goal"):
        place = getattr(v, name)
        if place is not None and not all(map(_near, place)):
            yield f"{name}: {place} is no place"
    if v.type != "plane":
        return
    if not v.vmin:
        yield "vmin: a plane needs its least speed"
    elif v.vmin > v.vmax:
        yield f"vmin: {v.vmin:g} m/s is more than vmax, {v.vmax:g}"
    if v.start_heading_deg is None or not math.isfinite(v.start_heading_deg):
        yield "start_heading_deg: a plane needs the heading that it starts with"


def _wrong_with_obstacle(each: Obstacle) -> Iterator[str]:
    if isinstance(each, Box):
        yield from _span("min and max", each.min, each.max)
    elif isinstance(each, Cylinder):
        if not all(map(_near, each.center)):
            yield f"center: {each.center} is no place"
        if not 0.0 < each.radius <= FARTHEST:
            yield f"radius: {each.radius} is not positive, or larger than the earth"
        yield from _span("floor and ceiling", (each.floor,), (each.ceiling,))
    else:
        yield from _wrong_with_prism(each)


def _wrong_with_prism(each: NoFly | Fence) -> Iterator[str]:
    yield from _span("floor and ceiling", (each.floor,), (each.ceiling,))
    if fault := polygon_fault(each.polygon):
        yield f"polygon: {fault}"


def polygon_fault(polygon: Sequence[Corner]) -> str:
    """Why it is no simple polygon, of which one can say what is inside; empty: it is one."""
    corners = open_ring(polygon)
    if not all(_near(value) for corner in corners for value in corner):
        return "a corner is no place"
    if len(corners) < 3:
        return f"it has {len(corners)} different corners, three or more are needed"
    if crossing := _crossing(corners):
        one, other = crossing
        return f"the sides after corners {corners[one]} and {corners[other]} cross or touch"
    return ""


def open_ring(polygon: Sequence[Corner]) -> list[Corner]:
    """The corners without repeats, and without the first said again at the end."""
    return [corner for i, corner in enumerate(polygon) if corner != polygon[i + 1 - len(polygon)]]


def _near(value: float) -> bool:
    return -FARTHEST <= value <= FARTHEST  # so it is no NaN either


def _span(name: str, low: Sequence[float], high: Sequence[float]) -> Iterator[str]:
    if not all(map(_near, (*low, *high))):
        yield f"{name}: {list(low)} and {list(high)}, but {FARTHEST:g} m is the farthest"
    elif not all(a < b for a, b in zip(low, high, strict=True)):
        yield f"{name}: {list(low)} is not below {list(high)}"


def _crossing(corners: Sequence[Corner]) -> tuple[int, int] | None:
    """Two sides of a polygon that have more in common than a corner between them."""
    n, ends = len(corners), np.array([corners, [*corners[1:], corners[0]]])
    low, high = ends.min(axis=0), ends.max(axis=0)
    for i in range(n):
        # Only sides whose boxes touch can meet: with thousands of corners that matters.
        near = ((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i])).all(axis=1)
        for j in (np.flatnonzero(near) + i + 1).tolist():
            a, b, c, d = corners[i], corners[i + 1 - n], corners[j], corners[j + 1 - n]
            if j == i + 1 or (i == 0 and j == n - 1):
                # Neighbours share a corner; folded back onto each other they share more.
                shared, one, other = (b, a, d) if j == i + 1 else (a, b, c)
                if _turn(shared, one, other) == 0.0 and _ahead(shared, one, other) > 0.0:
                    return i, j
            elif _astride(a, b, c, d) and _astride(c, d, a, b):
                return i, j
    return None


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _ahead(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[0] - a[0]) + (b[1] - a[1]) * (c[1] - a[1])


def _astride(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Whether no side of the line through ``a`` and ``b`` has both ``c`` and ``d``."""
    one, other = _turn(a, b, c), _turn(a, b, d)
    return min(one, other) <= 0.0 <= max(one, other)
