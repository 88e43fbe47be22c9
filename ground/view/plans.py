"""What a vehicle's autopilot has stored, in the scene: mission, geofence, rally points, and home."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import rerun as rr

from ground.view import shapes, style
from ground.view.canvas import Canvas, Path
from ground.view.frames import Datum
from zmav import wire
from zmav.formats import fence
from zmav.wire import Vector

POST = 4.0
"""m: how high a fence is drawn; the autopilot's own parameters say how high it really is"""


def paint_plan(
    canvas: Canvas, path: Path, plan: wire.Mission, datum: Datum, home_amsl: float | None, shade: style.Colour
) -> None:
    """Draw a vehicle's plan of one kind in place of the one before."""
    if plan.kind == "fence":
        _paint_fence(canvas, (*path, "fence"), plan.items, datum, home_amsl)
        return
    places = [(i, _place(item, datum, home_amsl)) for i, item in enumerate(plan.items)]
    known = [(i, place) for i, place in places if place is not None]
    points, line = (*path, plan.kind), (*path, plan.kind, "line")
    if not known:
        canvas.clear(points)
        canvas.clear(line)
        return
    names = [f"rally {i}" if plan.kind == "rally" else str(i) for i, _ in known]
    shades = [style.WHITE if i == plan.current else style.MISSION for i, _ in known]
    where = [place for _, place in known]
    canvas.put(points, rr.Points3D(where, colors=shades, radii=style.points(4.0), labels=names, show_labels=True))
    drawn = rr.LineStrips3D([where], colors=style.faded(shade, 150), radii=style.points(1.0))
    canvas.put(line, drawn if plan.kind == "mission" and len(where) > 1 else None)


def _place(item: wire.MissionItem, datum: Datum, home_amsl: float | None) -> Vector | None:
    """Where an item is; None for one that has no place, as a change of speed."""
    if item.frame.startswith("MAV_FRAME_LOCAL_NED"):
        return shapes.vector((item.x, item.y, item.z))
    if item.x == 0.0 and item.y == 0.0:
        return None
    relative = "RELATIVE" in item.frame or "TERRAIN" in item.frame
    ground = home_amsl if home_amsl is not None else (datum.origin.alt_amsl if datum.origin else 0.0)
    return datum.place(item.x, item.y, ground + item.z if relative else item.z)


def _paint_fence(
    canvas: Canvas, path: Path, items: Sequence[wire.MissionItem], datum: Datum, home_amsl: float | None
) -> None:
    found, _ = fence.parse(items)
    strips: list[list[Vector]] = []
    shades: list[style.Colour] = []
    for shape in found:
        outline = _outline(shape, datum)
        if len(outline) < 3 or datum.origin is None:
            continue
        ground = datum.origin.alt_amsl - (datum.origin.alt_amsl if home_amsl is None else home_amsl)
        drawn = shapes.edges(outline, ground - POST, ground)
        strips += drawn
        inside = isinstance(shape, (fence.Polygon, fence.Circle)) and shape.inclusion
        shades += [style.STAY_INSIDE if inside else style.STAY_OUT] * len(drawn)
    canvas.put(path, rr.LineStrips3D(strips, colors=shades, radii=style.points(1.2)) if strips else None)


def _outline(shape: fence.Shape, datum: Datum) -> list[tuple[float, float]]:
    if isinstance(shape, fence.Polygon):
        corners = [datum.place(lat, lon, 0.0) for lat, lon in shape.vertices]
        return [corner[:2] for corner in corners if corner is not None]
    if isinstance(shape, fence.Circle) and shapes.number(shape.radius):
        center = datum.place(*shape.center, 0.0)
        return [] if center is None else shapes.circle(center[:2], shape.radius, 48)
    return []


def home_of(message: wire.LastMessage) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees and altitude AMSL of a HOME_POSITION; None where it has no such fields."""
    try:
        raw: list[Any] = [message.fields[name] for name in ("latitude", "longitude", "altitude")]
        return float(raw[0]) / 1e7, float(raw[1]) / 1e7, float(raw[2]) / 1e3
    except (KeyError, TypeError, ValueError):
        return None


def paint_home(canvas: Canvas, path: Path, home: tuple[float, float, float], label: str, datum: Datum) -> None:
    place = datum.place(*home)
    if place is not None:
        point = rr.Points3D(
            [place], colors=style.HOME, radii=style.points(3.5), labels=f"home of {label}", show_labels=False
        )
        canvas.put((*path, "home"), point)
