"""A scene and its plan as a picture: from above and from the side, with what is nearest to what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from agents.planner.model.plans import Plan
from agents.planner.model.scene import Box, Cylinder, NoFly, Scene
from agents.planner.model.verify import Report
from agents.planner.solve.bound import least_makespan
from zmav.figures import save

SOLID, ZONE, FENCE = "#9aa0a6", "#e8710a", "#188038"
INK, BAD = "#202124", "#d93025"
NAMES = 32
"""with more vehicles than this, only those that something is said about are named"""
VIEWS = ((0, 1), (0, 2))
"""the axes across and up: from above, and from the south"""


def draw(scene: Scene, plan: Plan, report: Report | None, path: Path) -> None:
    """Write a picture (PNG, or what the file's name says). Raises :class:`BadInput` where that cannot be.

    Without a plan the scene is drawn, and whom its error names.
    """
    save(figure_of(scene, plan, report), path)


def figure_of(scene: Scene, plan: Plan, report: Report | None) -> Figure:
    """Both views, one above the other at the same scale, under what is to be said of the plan."""
    wide, deep, tall = (high - low for low, high in zip(scene.bounds.min, scene.bounds.max, strict=True))
    height = min(10.0, 9.0 * (deep + tall) / wide) + 2.5
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(9.5, height), dpi=110, layout="constrained")
        for ax, (x, y) in zip(figure.subplots(2, 1, sharex=True, height_ratios=(deep, tall)), VIEWS, strict=True):
            _world(ax, scene, x, y)
            _vehicles(ax, scene, plan, report, x, y)
            low, high = scene.bounds.min, scene.bounds.max
            names = ("east (m)", "north (m)", "up (m)")
            ax.set(xlim=(low[x], high[x]), ylim=(low[y], high[y]), aspect="equal", ylabel=names[y])
        ax.set_xlabel("east (m)")
        signs = [Line2D([], [], color=INK, ls="", marker="o", mfc=fill) for fill in (INK, "none")]
        signs += [Patch(color=SOLID), Line2D([], [], color=BAD, ls="", marker="o", mfc="none", ms=9)]
        words = ("start", "goal", "obstacle (darker: higher)", "nearest to each other")
        figure.legend(signs, words, loc="outside lower center", ncols=4, frameon=False)
        figure.suptitle(_title(scene, plan, report), fontsize=10.5, color=BAD if plan.status == "error" else INK)
    return figure


def _world(ax: Axes, scene: Scene, across: int, up: int) -> None:
    """Obstacles and the fence. From above, a higher obstacle is darker."""
    top = scene.bounds.max[2] or 1.0
    for each in scene.obstacles:
        height = each.max[2] if isinstance(each, Box) else each.ceiling
        shade = 0.18 + 0.5 * max(0.0, min(1.0, height / top)) if up == 1 else 0.14
        patch, colour = _patch(each, up), ZONE if isinstance(each, NoFly) else SOLID
        patch.set(facecolor=(colour, shade), edgecolor=colour, linewidth=0.6, zorder=1)
        ax.add_patch(patch)
    if scene.geofence is not None:
        fence = _prism(scene.geofence.polygon, scene.geofence.floor, scene.geofence.ceiling, up)
        fence.set(fill=False, edgecolor=FENCE, linewidth=1.4, linestyle="--", zorder=2)
        ax.add_patch(fence)


def _patch(each: Box | Cylinder | NoFly, up: int) -> Any:
    if isinstance(each, Box):
        return Rectangle((each.min[0], each.min[up]), each.max[0] - each.min[0], each.max[up] - each.min[up])
    if isinstance(each, NoFly):
        return _prism(each.polygon, each.floor, each.ceiling, up)
    if up == 1:
        return Circle(each.center, each.radius)
    return Rectangle((each.center[0] - each.radius, each.floor), 2 * each.radius, each.ceiling - each.floor)


def _prism(polygon: Sequence[tuple[float, float]], floor: float, ceiling: float, up: int) -> Any:
    if up == 1:
        return Polygon(polygon, closed=True)
    xs = [x for x, _ in polygon]
    return Rectangle((min(xs), floor), max(xs) - min(xs), ceiling - floor)


def _colours(n: int) -> list[tuple[float, float, float]]:
    """As many colours as vehicles, neighbours well apart."""
    wheel = mpl.colormaps["hsv"]
    return [tuple(0.82 * c for c in wheel((0.618034 * k) % 1.0)[:3]) for k in range(n)]  # type: ignore[misc]


def _vehicles(ax: Axes, scene: Scene, plan: Plan, report: Report | None, across: int, up: int) -> None:
    """Tracks, starts as discs and goals as rings, of the vehicle's size where that can be seen; red if an error names
    them; and where two are nearest to each other.
    """
    seen = 0.006 * max(high - low for low, high in zip(scene.bounds.min, scene.bounds.max, strict=True))
    shades, motions = _colours(len(scene.vehicles)), plan.motions()
    lines = [motions[v.id][:, [1 + across, 1 + up]] for v in scene.vehicles if v.id in motions]
    tracked = [(*shades[k], 0.85) for k, v in enumerate(scene.vehicles) if v.id in motions]
    ax.add_collection(LineCollection(lines, colors=tracked, linewidths=1.1 if len(lines) <= 64 else 0.6, zorder=3))
    blamed, nearest = set(plan.error.ids) if plan.error else set(), report.closest if report else None
    named = blamed | (set(nearest.ids) if nearest else set())
    goals = {v.id: v.goal for v in scene.vehicles if v.goal is not None}
    if scene.assignment == "unlabelled":
        goals = {v: (scene.goals or [])[k] for v, k in report.goals.items()} if report else {}
    for k, v in enumerate(scene.vehicles):
        shade: Any = BAD if v.id in blamed else SOLID if blamed else shades[k]
        at, size = (v.start[across], v.start[up]), max(seen, v.radius)
        ax.add_patch(Circle(at, size, facecolor=shade, edgecolor="none", alpha=0.75, zorder=4, clip_on=False))
        if goal := goals.get(v.id):
            ax.add_patch(_ring((goal[across], goal[up]), size, shade))
        if v.id in named or (len(scene.vehicles) <= NAMES and up == 1):
            others = [(o.start[across], o.start[up]) for o in scene.vehicles if o is not v]
            edges = (scene.bounds.min[across], scene.bounds.max[across])
            _name(ax, v.id, at, others, edges, BAD if v.id in blamed else INK)
    if nearest is not None and motions.keys() >= set(nearest.ids):
        ways = [motions[name] for name in nearest.ids]
        points = np.array([[np.interp(nearest.time, way[:, 0], way[:, 1 + k]) for k in (across, up)] for way in ways])
        ax.add_patch(_ring(tuple(points.mean(axis=0)), 5.0 * seen, BAD))
        ax.plot(points[:, 0], points[:, 1], color=BAD, linewidth=1.2, marker=".", markersize=4, zorder=7)


def _name(
    ax: Axes,
    name: str,
    at: tuple[float, float],
    others: Sequence[tuple[float, float]],
    edges: tuple[float, float],
    colour: str,
) -> None:
    """On the side where neither the nearest of the others is nor the picture's edge."""
    near = min(others, key=lambda other: math.dist(at, other), default=at)
    share = (at[0] - edges[0]) / (edges[1] - edges[0])
    right, above = share < 0.1 or (share < 0.9 and at[0] >= near[0]), at[1] >= near[1]
    ax.annotate(
        name,
        at,
        xytext=(4 if right else -4, 4 if above else -4),
        textcoords="offset points",
        ha="left" if right else "right",
        va="bottom" if above else "top",
        fontsize=7,
        zorder=6,
        color=colour,
    )


def _ring(at: tuple[float, float], radius: float, shade: Any) -> Circle:
    return Circle(at, radius, fill=False, edgecolor=shade, linewidth=1.1, zorder=4, clip_on=False)


def _title(scene: Scene, plan: Plan, report: Report | None) -> str:
    """Two lines: what it is, and what is nearest to what."""
    name = scene.name or "scene"
    if plan.error is not None:
        text = plan.error.message if len(plan.error.message) < 140 else plan.error.message[:137] + "..."
        return f"{name}: {plan.error.code}\n{text}"
    first = f"{name}: {len(scene.vehicles)} vehicles, makespan {plan.makespan:.1f} s"
    if (bound := least_makespan(scene)) > 0.0:
        first += f", {plan.makespan / bound:.2f} × the straight-line bound"
    words = []
    if report is not None and report.closest is not None:
        one, other = report.closest.ids
        words.append(f"{report.closest.clearance:.2f} m between {one} and {other} at {report.closest.time:.1f} s")
    if report is not None and math.isfinite(report.obstacle_clearance):
        words.append(f"{report.obstacle_clearance:.2f} m from obstacles")
    return first + ("\nleast clearance " + ", ".join(words) if words else "")
