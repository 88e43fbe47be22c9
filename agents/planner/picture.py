"""A scene and its plan as a picture: from above and from the side, with what is nearest to what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Rectangle

from agents.planner.model.plans import Plan
from agents.planner.model.problem import Motion
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
    scale = min(9.0 / wide, 10.0 / (deep + tall))
    across, top, side = (max(0.5, scale * size) for size in (wide, deep, tall))
    left, under, between, over = 0.75, 0.95, 0.75, 0.95
    width, height = max(9.0, across) + left + 0.35, under + side + between + top + over
    indent = left + (max(9.0, across) - across) / 2.0
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(width, height), dpi=110)
        FigureCanvasAgg(figure)
        places = ((under + side + between, top), (under, side))
        motions = plan.motions()
        for (x, y), (bottom, tallness) in zip(VIEWS, places, strict=True):
            ax = figure.add_axes((indent / width, bottom / height, across / width, tallness / height))
            _world(ax, scene, x, y)
            _tracks(ax, scene, motions, x, y)
            _ends(ax, scene, plan, report, x, y)
            _nearest(ax, scene, motions, report, x, y)
            _frame(ax, scene, x, y)
        shade = BAD if plan.status == "error" else INK
        words = _title(scene, plan, report)
        figure.text(0.5, 1.0 - 0.12 / height, words, ha="center", va="top", fontsize=10.5, color=shade)
        figure.legend(handles=_legend(scene, plan, report), loc="lower center", ncols=6, frameon=False)
    return figure


def _frame(ax: Axes, scene: Scene, across: int, up: int) -> None:
    low, high = scene.bounds.min, scene.bounds.max
    size = high[across] - low[across], high[up] - low[up]
    ax.add_patch(Rectangle((low[across], low[up]), *size, fill=False, edgecolor=INK, linewidth=1.2, zorder=8))
    names = ("east (m)", "north (m)", "up (m)")
    ax.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal", ylabel=names[up])
    if up == 2:
        ax.set_xlabel(names[across])
    ax.set_title("from above" if up == 1 else "from the south", fontsize=9, loc="left")
    ax.tick_params(length=2)
    for side in ax.spines.values():
        side.set_visible(False)


def _world(ax: Axes, scene: Scene, across: int, up: int) -> None:
    """Obstacles and the fence. From above, a higher obstacle is darker."""
    top = scene.bounds.max[2] or 1.0
    groups: dict[str, tuple[list[Any], list[float]]] = {SOLID: ([], []), ZONE: ([], [])}
    for each in scene.obstacles:
        patches, shades = groups[ZONE if isinstance(each, NoFly) else SOLID]
        height = each.max[2] if isinstance(each, Box) else each.ceiling
        patches.append(_patch(each, up))
        shades.append(0.18 + 0.5 * max(0.0, min(1.0, height / top)) if up == 1 else 0.14)
    for colour, (patches, shades) in groups.items():
        if patches:
            red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
            faces = [(red, green, blue, shade * (0.6 if colour == ZONE else 1.0)) for shade in shades]
            ax.add_collection(
                PatchCollection(patches, facecolors=faces, edgecolors=colour, linewidths=0.7 - 0.2 * up, zorder=1)
            )
    if scene.geofence is not None:
        fence = _prism(scene.geofence.polygon, scene.geofence.floor, scene.geofence.ceiling, up)
        fence.set(fill=False, edgecolor=FENCE, linewidth=1.4, linestyle="--", zorder=2)
        ax.add_patch(fence)


def _patch(each: Box | Cylinder | NoFly, up: int) -> Any:
    if isinstance(each, Box):
        return Rectangle((each.min[0], each.min[up]), each.max[0] - each.min[0], each.max[up] - each.min[up])
    if isinstance(each, Cylinder):
        if up == 1:
            return Circle(each.center, each.radius)
        return Rectangle((each.center[0] - each.radius, each.floor), 2 * each.radius, each.ceiling - each.floor)
    return _prism(each.polygon, each.floor, each.ceiling, up)


def _prism(polygon: Sequence[tuple[float, float]], floor: float, ceiling: float, up: int) -> Any:
    if up == 1:
        return Polygon(polygon, closed=True)
    xs = [x for x, _ in polygon]
    return Rectangle((min(xs), floor), max(xs) - min(xs), ceiling - floor)


def colours(n: int) -> list[tuple[float, float, float]]:
    """As many colours as vehicles, neighbours well apart."""
    wheel = mpl.colormaps["hsv"]
    return [tuple(0.82 * c for c in wheel((0.618034 * k) % 1.0)[:3]) for k in range(n)]  # type: ignore[misc]


def _tracks(ax: Axes, scene: Scene, motions: dict[str, Motion], across: int, up: int) -> None:
    shades = colours(len(scene.vehicles))
    lines = [motions[v.id][:, [1 + across, 1 + up]] if v.id in motions else np.empty((0, 2)) for v in scene.vehicles]
    width = 1.1 if len(lines) <= 64 else 0.6
    ax.add_collection(
        LineCollection(lines, colors=[(*c, 0.85) for c in shades], linewidths=width, capstyle="round", zorder=3)
    )


def _ends(ax: Axes, scene: Scene, plan: Plan, report: Report | None, across: int, up: int) -> None:
    """Starts as discs and goals as rings, of the vehicle's size where that can be seen; red if an error names them."""
    seen = 0.006 * max(high - low for low, high in zip(scene.bounds.min, scene.bounds.max, strict=True))
    shades = colours(len(scene.vehicles))
    blamed = set(plan.error.ids) if plan.error else set()
    said = blamed | (set(report.closest.ids) if report and report.closest else set())
    for k, v in enumerate(scene.vehicles):
        shade: Any = BAD if v.id in blamed else SOLID if blamed else shades[k]
        at = (v.start[across], v.start[up])
        ax.add_patch(
            Circle(at, max(seen, v.radius), facecolor=shade, edgecolor="none", alpha=0.75, zorder=4, clip_on=False)
        )
        goal = v.goal if scene.goals is None or scene.assignment == "labelled" else None
        if goal is not None:
            ax.add_patch(_ring((goal[across], goal[up]), max(seen, v.radius), shade))
            if not plan.trajectories:
                ends = ([at[0], goal[across]], [at[1], goal[up]])
                ax.plot(*ends, color=shade, linewidth=0.6, linestyle=":", zorder=3)
        if v.id in said or (len(scene.vehicles) <= NAMES and up == 1):
            ax.annotate(
                v.id,
                at,
                xytext=(4, 4),
                textcoords="offset points",
                fontsize=7,
                zorder=6,
                color=BAD if v.id in blamed else INK,
            )
    if scene.assignment == "unlabelled":
        owner = {goal: name for name, goal in report.goals.items()} if report else {}
        index = {v.id: k for k, v in enumerate(scene.vehicles)}
        radius = max(seen, min(v.radius for v in scene.vehicles))
        for g, goal in enumerate(scene.goals or []):
            shade = BAD if f"goals[{g}]" in blamed else shades[index[owner[g]]] if g in owner else SOLID
            ax.add_patch(_ring((goal[across], goal[up]), radius, shade))


def _ring(at: tuple[float, float], radius: float, shade: Any) -> Circle:
    return Circle(at, radius, fill=False, edgecolor=shade, linewidth=1.1, zorder=4, clip_on=False)


def _nearest(ax: Axes, scene: Scene, motions: dict[str, Motion], report: Report | None, across: int, up: int) -> None:
    """Where two vehicles are nearest to each other."""
    if report is None or report.closest is None:
        return
    nearest = report.closest
    places = [place_of(motions[name], nearest.time) for name in nearest.ids if name in motions]
    if len(places) != 2:
        return
    points = np.array([[place[across], place[up]] for place in places])
    size = 0.03 * max(scene.bounds.max[0] - scene.bounds.min[0], 1.0)
    middle = points.mean(axis=0)
    ax.add_patch(Circle(tuple(middle), size, fill=False, edgecolor=BAD, linewidth=1.6, zorder=7))
    ax.plot(points[:, 0], points[:, 1], color=BAD, linewidth=1.2, marker=".", markersize=4, zorder=7)


def place_of(motion: Motion, t: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(3,): where a motion is at a time; its last place after its end."""
    return np.array([np.interp(t, motion[:, 0], motion[:, k]) for k in (1, 2, 3)])


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


def _legend(scene: Scene, plan: Plan, report: Report | None) -> list[Any]:
    dot: dict[str, Any] = {"linestyle": "none", "markersize": 8}
    found: list[Any] = [
        Line2D([], [], marker="o", color=INK, alpha=0.75, label="start", **dot),
        Line2D([], [], marker="o", color=INK, fillstyle="none", label="goal", **dot),
    ]
    if any(not isinstance(each, NoFly) for each in scene.obstacles):
        found.append(Rectangle((0, 0), 1, 1, facecolor=SOLID, label="obstacle (darker: higher)"))
    if any(isinstance(each, NoFly) for each in scene.obstacles):
        found.append(Rectangle((0, 0), 1, 1, facecolor=ZONE, alpha=0.4, label="no-fly zone"))
    if scene.geofence is not None:
        found.append(Line2D([], [], color=FENCE, linestyle="--", label="geofence"))
    if report is not None and report.closest is not None and plan.trajectories:
        found.append(Line2D([], [], marker="o", color=BAD, fillstyle="none", label="nearest to each other", **dot))
    return found
