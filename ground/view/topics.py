"""What the planner tells the fleet, in the scene: the goals in its book, the plan that is flown, the obstacles.

Any other topic under ``@fleet/*`` is told in the log of events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr

from ground.view import style
from ground.view.canvas import NED, Canvas, Path
from ground.view.frames import usable
from zmav import wire
from zmav.wire import Vector, swarm

SIDES = 24
"""of the outline that is drawn of a circle"""
SAID = 200
"""characters of a topic that are shown in a line of the log"""
UNDRAWN = ("charge", "order")
"""topics that have no place in space: several times a second, who is in charge; what was ordered"""
OVER = ("done", "failed", "cancelled")
"""states of goals that are not drawn any more"""


@dataclass
class Shapes:
    """What one topic comes to, in NED. What cannot be drawn is left out."""

    marks: list[tuple[Vector, str]] = field(default_factory=list)
    """places with their labels"""
    lines: list[tuple[list[Vector], str]] = field(default_factory=list)
    """paths, each with the vehicle that flies it, or nobody"""
    boxes: list[tuple[Vector, Vector]] = field(default_factory=list)
    """two opposite corners each"""
    prisms: list[tuple[list[swarm.Corner], float, float]] = field(default_factory=list)
    """outline, top and bottom (m down) of upright bodies; a cylinder's outline has many corners"""

    def mark(self, place: Vector, label: str) -> None:
        if usable(place):
            self.marks.append((place, label[:40]))

    def line(self, points: Sequence[Vector], label: str = "") -> None:
        if len(points) > 1 and all(map(usable, points)):
            self.lines.append((list(points), label))

    def loop(self, outline: Sequence[swarm.Corner], down: float) -> None:
        """An area's edge: walls would hide who flies in it."""
        self.line([(n, e, down) for n, e in [*outline, *outline[:1]]])

    def prism(self, outline: list[swarm.Corner], top: float, bottom: float) -> None:
        if len(outline) > 2 and all(usable((n, e, down)) for n, e in outline for down in (top, bottom)):
            self.prisms.append((outline, top, bottom))


def paint(canvas: Canvas, topic: str, payload: bytes) -> str | None:
    """Draw one topic's newest document; what there is to say of one that has no form here.

    Raises :class:`~zmav.errors.BadInput` for a goal, a plan or obstacles that are not what they should be.
    """
    if topic in UNDRAWN:
        return None
    if topic not in TOPICS:
        return f"{topic}: {payload[:SAID].decode('utf-8', 'replace')}" if payload else None
    kind, find = TOPICS[topic]
    found, shade, path = Shapes(), style.TOPICS[topic], (*NED, "topics", topic)
    if payload:
        find(wire.decode(payload, kind, topic), found)
    _marks(canvas, (*path, "points"), found, shade)
    _lines(canvas, (*path, "lines"), found, shade)
    _boxes(canvas, (*path, "boxes"), found, shade)
    _prisms(canvas, (*path, "prisms"), found, shade)
    return None


def _goals(book: swarm.Book, found: Shapes) -> None:
    for entry in book.goals:
        if entry.state in OVER:
            continue
        goal = entry.goal
        if isinstance(goal, swarm.GoTo):
            for number, place in enumerate(goal.to):
                found.mark(place, goal.vehicles[number] if goal.labelled and number < len(goal.vehicles) else entry.id)
        elif isinstance(goal, swarm.Formation):
            found.mark(goal.at, entry.id)
        elif isinstance(goal, swarm.Search):
            found.loop(goal.polygon, 0.0)
        elif isinstance(goal, swarm.Land):
            for n, e in goal.at:
                found.mark((n, e, 0.0), entry.id)


def _plan(report: swarm.PlanReport, found: Shapes) -> None:
    for vehicle, track in report.tracks.items():
        found.line([(n, e, d) for _, n, e, d in track], vehicle)


def _obstacles(told: swarm.ObstacleMap, found: Shapes) -> None:
    for obstacle in told.obstacles:
        what = obstacle.what
        if isinstance(what, swarm.Box):
            if usable(what.low) and usable(what.high):
                found.boxes.append((what.low, what.high))
        elif isinstance(what, swarm.Cylinder):
            found.prism(_circle(what.center, what.radius), -what.ceiling, -what.floor)
        elif isinstance(what, swarm.NoFly):
            found.prism(what.polygon, -what.ceiling, -what.floor)
        elif isinstance(what, swarm.Geofence):
            found.loop(what.polygon, -what.floor)
        elif isinstance(what, swarm.Ball):
            n, e, d = what.center
            found.prism(_circle((n, e), what.radius), d - what.radius, d + what.radius)


TOPICS: dict[str, tuple[type[Any], Callable[[Any, Shapes], None]]] = {
    "goal": (swarm.Book, _goals),
    "plan": (swarm.PlanReport, _plan),
    "obstacle": (swarm.ObstacleMap, _obstacles),
}
"""what is drawn: the type of its document, and what of it has a place"""


def _marks(canvas: Canvas, path: Path, found: Shapes, shade: style.Colour) -> None:
    points = rr.Points3D(
        [place for place, _ in found.marks],
        colors=shade,
        radii=style.points(6.0),
        labels=[label for _, label in found.marks],
        show_labels=len(found.marks) <= 12,
    )
    canvas.put(path, points if found.marks else None)


def _lines(canvas: Canvas, path: Path, found: Shapes, shade: style.Colour) -> None:
    """Each in its vehicle's own colour where it is called after one."""
    shades = [style.faded(style.colour(label), 200) if label else shade for _, label in found.lines]
    strips = rr.LineStrips3D([points for points, _ in found.lines], colors=shades, radii=style.points(1.2))
    canvas.put(path, strips if found.lines else None)


def _boxes(canvas: Canvas, path: Path, found: Shapes, shade: style.Colour) -> None:
    if not found.boxes:
        return canvas.clear(path)
    one, other = np.array([low for low, _ in found.boxes]), np.array([high for _, high in found.boxes])
    centers, halves = (one + other) / 2, np.abs(other - one) / 2
    solid = rr.Boxes3D(centers=centers, half_sizes=halves, colors=shade, fill_mode=rr.components.FillMode.Solid)
    return canvas.put(path, solid)


def _prisms(canvas: Canvas, path: Path, found: Shapes, shade: style.Colour) -> None:
    """Walls, and their edges in the same colour: a cylinder and a no-fly zone alike."""
    if not found.prisms:
        canvas.clear(path)
        return canvas.clear((*path, "walls"))
    strips = [strip for prism in found.prisms for strip in _edges(*prism)]
    canvas.put(path, rr.LineStrips3D(strips, colors=style.faded(shade, 255), radii=style.points(1.0)))
    corners: list[Vector] = []
    for outline, top, bottom in found.prisms:
        for (n, e), (n2, e2) in zip(outline, [*outline[1:], outline[0]], strict=True):
            a, b, c, d = (n, e, bottom), (n2, e2, bottom), (n2, e2, top), (n, e, top)
            corners += [a, b, c, a, c, d]
    return canvas.put((*path, "walls"), rr.Mesh3D(vertex_positions=corners, albedo_factor=shade))


def _circle(center: swarm.Corner, radius: float) -> list[swarm.Corner]:
    """North and east of the corners of a circle's outline."""
    turns = [2.0 * math.pi * step / SIDES for step in range(SIDES)]
    return [(center[0] + radius * math.cos(turn), center[1] + radius * math.sin(turn)) for turn in turns]


def _edges(outline: Sequence[swarm.Corner], top: float, bottom: float) -> list[list[Vector]]:
    """The strips that draw an upright body: both outlines, and its corners' edges (of a round one, some)."""
    loop = [*outline, outline[0]]
    every = 1 if len(outline) <= 12 else len(outline) // 8
    posts = [[(n, e, bottom), (n, e, top)] for n, e in outline[::every]]
    return [[(n, e, bottom) for n, e in loop], [(n, e, top) for n, e in loop], *posts]
