"""Geofences: polygons, circles and a return point, and the mission items that carry them.

Encoding (https://mavlink.io/en/services/mission.html#geofence-plan): a polygon is a run of vertices, each of which says
in param1 how many there are; a circle says its radius in param1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from zmav.errors import BadInput
from zmav.formats.items import Place
from zmav.wire import MissionItem

PREFIX = "MAV_CMD_NAV_FENCE_"
VERTEX = {True: f"{PREFIX}POLYGON_VERTEX_INCLUSION", False: f"{PREFIX}POLYGON_VERTEX_EXCLUSION"}
CIRCLE = {True: f"{PREFIX}CIRCLE_INCLUSION", False: f"{PREFIX}CIRCLE_EXCLUSION"}
RETURN = f"{PREFIX}RETURN_POINT"
FRAME, RETURN_FRAME = "MAV_FRAME_GLOBAL", "MAV_FRAME_GLOBAL_RELATIVE_ALT"


class Polygon(NamedTuple):
    """Stay inside it (``inclusion``) or out of it; vertices in degrees of latitude and longitude."""

    vertices: tuple[tuple[float, float], ...]
    inclusion: bool = True


class Circle(NamedTuple):
    """``center`` in degrees, ``radius`` in metres."""

    center: tuple[float, float]
    radius: float
    inclusion: bool = True


class Return(NamedTuple):
    """Where to go on a breach: degrees, and metres above home."""

    place: Place


Shape = Polygon | Circle | Return


def items(shapes: Iterable[Shape]) -> list[MissionItem]:
    """The mission items of these shapes, in their order."""
    found: list[MissionItem] = []
    for shape in shapes:
        if isinstance(shape, Polygon):
            count = float(len(shape.vertices))
            found += [_item(VERTEX[shape.inclusion], count, *vertex) for vertex in shape.vertices]
        elif isinstance(shape, Circle):
            found.append(_item(CIRCLE[shape.inclusion], shape.radius, *shape.center))
        else:
            x, y, z = shape.place
            found.append(MissionItem(command=RETURN, frame=RETURN_FRAME, x=x, y=y, z=z))
    return found


def shapes(items: Sequence[MissionItem]) -> list[Shape]:
    """The shapes that these items carry; raises :class:`BadInput` that names every item at fault."""
    found, faults = parse(items)
    if faults:
        text = "; ".join(f"item {i}: {why}" for i, why in faults)
        raise BadInput(f"not a fence: {text}", field=f"items[{faults[0][0]}]", expected=faults[0][1])
    return found


def parse(items: Sequence[MissionItem]) -> tuple[list[Shape], list[tuple[int, str]]]:
    """The shapes that can be read, and what is wrong with the other items, by index."""
    found: list[Shape] = []
    faults: list[tuple[int, str]] = []
    i = 0
    while i < len(items):
        item, first = items[i], i
        i += 1
        size = (item.params[0] if item.params else None) or 0.0
        if item.command == RETURN:
            found.append(Return((item.x, item.y, item.z)))
        elif item.command in CIRCLE.values():
            if not 0.0 < size < math.inf:
                faults.append((first, f"a circle of radius {size:g} m"))
            found.append(Circle((item.x, item.y), size, item.command == CIRCLE[True]))
        elif item.command in VERTEX.values():
            while i < len(items) and i - first < size and items[i].command == item.command:
                i += 1
            run = items[first:i]
            why = _wrong(run, size)
            if why:
                faults.append((first, why))
            found.append(Polygon(tuple((v.x, v.y) for v in run), item.command == VERTEX[True]))
        else:
            faults.append((first, f"{item.command} is no fence item"))
    return found, faults


def _wrong(run: Sequence[MissionItem], size: float) -> str | None:
    if not size >= 3 or size % 1:
        return f"param1 is the number of vertices of its polygon, 3 or more, not {size:g}"
    if len(run) != size:
        return f"a polygon of {size:g} vertices (param1) ends after {len(run)}"
    for k, vertex in enumerate(run):
        said = vertex.params[0] if vertex.params else None
        if said != size:
            return f"a polygon of {size:g} vertices, but its vertex {k} says {said} in param1"
    return None


def _item(command: str, param1: float, lat_deg: float, lon_deg: float) -> MissionItem:
    return MissionItem(command=command, frame=FRAME, params=[param1], x=lat_deg, y=lon_deg)
