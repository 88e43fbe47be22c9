"""The fleet's topics in the scene: goals, plans, obstacles, and whatever else is put on ``@fleet/*``."""

from __future__ import annotations

import json

import numpy as np
import rerun as rr

from ground.view import shapes, style
from ground.view.canvas import NED, Canvas, Path
from ground.view.frames import Datum

SAID = 200
"""characters of a document that are shown in a line of the log where it cannot be drawn"""


def paint(canvas: Canvas, topic: str, payload: bytes, datum: Datum) -> str | None:
    """Draw one topic's newest document; what there is to say where nothing of it can be drawn."""
    try:
        document = json.loads(payload) if payload else None
    except (ValueError, RecursionError):
        return f"{topic}: {len(payload)} bytes that are no JSON"
    found = shapes.find(document, datum)
    shade = style.TOPICS.get(topic, style.OTHER_TOPIC)
    path = (*NED, "topics", topic)
    _marks(canvas, (*path, "points"), found.marks, shade)
    _lines(canvas, (*path, "lines"), found.lines, shade)
    _boxes(canvas, (*path, "boxes"), found.boxes, shade)
    _prisms(canvas, (*path, "prisms"), found.prisms, shade)
    if found or document in (None, {}, []):
        return None
    return f"{topic}: {json.dumps(document, ensure_ascii=False)[:SAID]}"


def _marks(canvas: Canvas, path: Path, marks: list[shapes.Mark], shade: style.Colour) -> None:
    if not marks:
        return canvas.clear(path)
    labels = [mark.label for mark in marks]
    points = rr.Points3D(
        [mark.pos for mark in marks],
        colors=shade,
        radii=style.points(6.0),
        labels=labels,
        show_labels=len(marks) <= 12 and any(labels),
    )
    return canvas.put(path, points)


def _lines(canvas: Canvas, path: Path, lines: list[shapes.Line], shade: style.Colour) -> None:
    """Each in its vehicle's own colour where it is called after one."""
    if not lines:
        return canvas.clear(path)
    shades = [style.faded(style.colour(line.label), 200) if line.label else shade for line in lines]
    strips = [line.points for line in lines]
    return canvas.put(path, rr.LineStrips3D(strips, colors=shades, radii=style.points(1.2)))


def _boxes(canvas: Canvas, path: Path, boxes: list[shapes.Box], shade: style.Colour) -> None:
    if not boxes:
        return canvas.clear(path)
    low, high = np.array([box.low for box in boxes]), np.array([box.high for box in boxes])
    solid = rr.Boxes3D(
        centers=(low + high) / 2, half_sizes=(high - low) / 2, colors=shade, fill_mode=rr.components.FillMode.Solid
    )
    return canvas.put(path, solid)


def _prisms(canvas: Canvas, path: Path, prisms: list[shapes.Prism], shade: style.Colour) -> None:
    """Walls, and their edges in the same colour: a cylinder and a no-fly zone alike."""
    if not prisms:
        canvas.clear(path)
        return canvas.clear((*path, "walls"))
    strips = [strip for prism in prisms for strip in shapes.edges(prism.outline, prism.top, prism.bottom)]
    canvas.put(path, rr.LineStrips3D(strips, colors=style.faded(shade, 255), radii=style.points(1.0)))
    corners: list[tuple[float, float, float]] = []
    for prism in prisms:
        for (n, e), (n2, e2) in zip(prism.outline, [*prism.outline[1:], prism.outline[0]], strict=True):
            a, b, c, d = (n, e, prism.bottom), (n2, e2, prism.bottom), (n2, e2, prism.top), (n, e, prism.top)
            corners += [a, b, c, a, c, d]
    return canvas.put((*path, "walls"), rr.Mesh3D(vertex_positions=corners, albedo_factor=shade))
