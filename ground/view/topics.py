"""The fleet's topics in the scene: goals, plans, obstacles, and whatever else is put on ``@fleet/*``.

Who publishes them decides their shape; here it is only looked for what has a place: a vector of three numbers is a
point (NED about the fleet's origin), a list of them a path, and an object with ``min`` and ``max``, or with ``center``
and ``radius`` or ``polygon``, ``floor`` and ``ceiling`` a body; without a ceiling a polygon is an area, drawn as its
outline at its floor. Both are heights above the origin, up positive.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from ground.view import style
from ground.view.canvas import NED, Canvas, Path
from ground.view.frames import FAR
from zmav.wire import Vector

SAID = 200
"""characters of a document that are shown in a line of the log where it cannot be drawn"""


def paint(canvas: Canvas, topic: str, payload: bytes) -> str | None:
    """Draw one topic's newest document; what there is to say where nothing of it can be drawn."""
    try:
        document = json.loads(payload) if payload else None
    except (ValueError, RecursionError):
        return f"{topic}: {len(payload)} bytes that are no JSON"
    found = find(document)
    shade = style.TOPICS.get(topic, style.OTHER_TOPIC)
    path = (*NED, "topics", topic)
    _marks(canvas, (*path, "points"), found.marks, shade)
    _lines(canvas, (*path, "lines"), found.lines, shade)
    _boxes(canvas, (*path, "boxes"), found.boxes, shade)
    _prisms(canvas, (*path, "prisms"), found.prisms, shade)
    if found or document in (None, {}, []):
        return None
    return f"{topic}: {json.dumps(document, ensure_ascii=False)[:SAID]}"


def _marks(canvas: Canvas, path: Path, marks: list[Mark], shade: style.Colour) -> None:
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


def _lines(canvas: Canvas, path: Path, lines: list[Line], shade: style.Colour) -> None:
    """Each in its vehicle's own colour where it is called after one."""
    if not lines:
        return canvas.clear(path)
    shades = [style.faded(style.colour(line.label), 200) if line.label else shade for line in lines]
    strips = [line.points for line in lines]
    return canvas.put(path, rr.LineStrips3D(strips, colors=shades, radii=style.points(1.2)))


def _boxes(canvas: Canvas, path: Path, boxes: list[Box], shade: style.Colour) -> None:
    if not boxes:
        return canvas.clear(path)
    low, high = np.array([box.low for box in boxes]), np.array([box.high for box in boxes])
    solid = rr.Boxes3D(
        centers=(low + high) / 2, half_sizes=(high - low) / 2, colors=shade, fill_mode=rr.components.FillMode.Solid
    )
    return canvas.put(path, solid)


def _prisms(canvas: Canvas, path: Path, prisms: list[Prism], shade: style.Colour) -> None:
    """Walls, and their edges in the same colour: a cylinder and a no-fly zone alike."""
    if not prisms:
        canvas.clear(path)
        return canvas.clear((*path, "walls"))
    strips = [strip for prism in prisms for strip in edges(prism.outline, prism.top, prism.bottom)]
    canvas.put(path, rr.LineStrips3D(strips, colors=style.faded(shade, 255), radii=style.points(1.0)))
    corners: list[tuple[float, float, float]] = []
    for prism in prisms:
        for (n, e), (n2, e2) in zip(prism.outline, [*prism.outline[1:], prism.outline[0]], strict=True):
            a, b, c, d = (n, e, prism.bottom), (n2, e2, prism.bottom), (n2, e2, prism.top), (n, e, prism.top)
            corners += [a, b, c, a, c, d]
    return canvas.put((*path, "walls"), rr.Mesh3D(vertex_positions=corners, albedo_factor=shade))


DEEP, MANY = 8, 5000
"""levels and values of a document that are looked at"""
PATHS = ("points", "path", "segment", "waypoints", "samples", "trajectory", "line")
PLACES = ("pos", "position", "goal", "place", "target")
NAMES = ("name", "id", "vehicle")


class Mark(NamedTuple):
    pos: Vector
    label: str


class Line(NamedTuple):
    points: list[Vector]
    label: str


class Box(NamedTuple):
    low: Vector
    high: Vector


class Prism(NamedTuple):
    """An upright body; a cylinder's outline has many corners. Heights are down positive, as all of NED."""

    outline: list[tuple[float, float]]
    top: float
    bottom: float


@dataclass
class Shapes:
    """All that was found in one document."""

    marks: list[Mark] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    prisms: list[Prism] = field(default_factory=list)

    def __bool__(self) -> bool:
        return any((self.marks, self.lines, self.boxes, self.prisms))


def find(document: Any) -> Shapes:
    """The shapes in a decoded JSON document; empty where there is nothing of a known form."""
    finder = _Finder()
    finder.look(document, "", deep=0)
    return finder.found


class _Finder:
    def __init__(self) -> None:
        self.found = Shapes()
        self._left = MANY

    def look(self, value: Any, label: str, deep: int) -> None:
        self._left -= 1
        if deep > DEEP or self._left < 0:
            return
        if isinstance(value, dict):
            self._object(value, label, deep)
        elif isinstance(value, list):
            self._list(value, label, deep)

    def _list(self, value: list[Any], label: str, deep: int) -> None:
        if (point := vector(value)) is not None:
            self.found.marks.append(Mark(point, label))
            return
        line = [self._point(each) for each in value[:MANY]]
        if len(line) > 1 and all(point is not None for point in line):
            self.found.lines.append(Line([point for point in line if point is not None], label))
            return
        for each in value:
            self.look(each, label, deep + 1)

    def _object(self, value: dict[str, Any], label: str, deep: int) -> None:
        named = next((value[key] for key in NAMES if isinstance(value.get(key), str)), label)[:40]
        if self._body(value):
            return
        if (point := self._point(value)) is not None:
            self.found.marks.append(Mark(point, named))
        for key, inner in value.items():
            if not isinstance(inner, (dict, list)) or (point is not None and key in PLACES):
                continue
            self.look(inner, named if key in PATHS + PLACES or named != label else str(key)[:40], deep + 1)

    def _point(self, value: Any) -> Vector | None:
        """A point given as a vector, as ``[t, x, y, z]``, or as an object that holds it."""
        if isinstance(value, list):
            return vector(value) or (vector(value[1:]) if len(value) == 4 else None)
        if not isinstance(value, dict):
            return None
        held = (vector(value.get(key)) for key in PLACES)
        return next((point for point in held if point is not None), None)

    def _body(self, value: dict[str, Any]) -> bool:
        low, high = vector(value.get("min")), vector(value.get("max"))
        if low and high:
            lower, upper = tuple(map(min, low, high)), tuple(map(max, low, high))
            self.found.boxes.append(Box(lower, upper))  # type: ignore[arg-type]  # map forgets how many there are
            return True
        radius, bottom, top = number(value.get("radius")), _down(value, "floor"), _down(value, "ceiling")
        if "polygon" in value:
            corners = [pair(each) for each in value["polygon"][:MANY]] if isinstance(value["polygon"], list) else []
            outline = [corner for corner in corners if corner is not None]
            if len(outline) < 3:
                return False
            if top is None:  # an area, as that of a search, and no body: walls would hide who flies in it
                loop = [(n, e, bottom or 0.0) for n, e in [*outline, outline[0]]]
                self.found.lines.append(Line(loop, ""))
            else:
                self.found.prisms.append(Prism(outline, top, bottom or 0.0))
            return True
        if radius is None or not 0.0 < radius <= FAR:
            return False
        if (flat := pair(value.get("center", value.get("pos")))) is None:
            return False
        self.found.prisms.append(Prism(circle(flat, radius), -50.0 if top is None else top, bottom or 0.0))
        return True


def number(value: Any) -> float | None:
    """``value`` where it is a number that can be drawn."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value) if math.isfinite(value) and abs(value) <= FAR else None


def vector(value: Any) -> Vector | None:
    """Three numbers, in NED."""
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        return None
    x, y, z = map(number, value)
    if x is None or y is None or z is None:
        return None
    return x, y, z


def pair(value: Any) -> tuple[float, float] | None:
    """North and east of two or three numbers."""
    if not isinstance(value, (list, tuple)) or len(value) not in (2, 3):
        return None
    x, y = number(value[0]), number(value[1])
    if x is None or y is None:
        return None
    return x, y


def circle(center: tuple[float, float], radius: float, sides: int = 24) -> list[tuple[float, float]]:
    """North and east of the corners of a circle's outline."""
    turns = [2.0 * math.pi * step / sides for step in range(sides)]
    return [(center[0] + radius * math.cos(turn), center[1] + radius * math.sin(turn)) for turn in turns]


def edges(outline: Sequence[tuple[float, float]], top: float, bottom: float) -> list[list[Vector]]:
    """The strips that draw an upright body: both outlines, and its corners' edges (of a round one, some)."""
    loop = [*outline, outline[0]]
    every = 1 if len(outline) <= 12 else len(outline) // 8
    posts = [[(n, e, bottom), (n, e, top)] for n, e in outline[::every]]
    return [[(n, e, bottom) for n, e in loop], [(n, e, top) for n, e in loop], *posts]


def _down(value: dict[str, Any], name: str) -> float | None:
    up = number(value.get(name))
    return None if up is None else -up
