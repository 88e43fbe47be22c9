"""The picture of a demo: tracks from above, heights over time with the story's steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zmav.errors import needs
from zmav.figures import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from agents.demo.play import Mark
    from agents.demo.watch import Row

NAMED = 12
"""tracks that get a name each; more are a crowd"""
LEAST = 12.0
"""m that is seen from above at least, north and east: a way along a line is no line"""
STILL = 3.0
"""s that are shown before the first moves and after the last has come to rest"""
STIRRED = 0.3
"""m that a vehicle is from where it begins or ends while it flies"""


def draw(names: Sequence[str], rows: Sequence[Row], marks: Sequence[Mark], title: str, path: Path) -> None:
    """PNG, SVG or PDF by the name. Raises :class:`BadConfig` without matplotlib, :class:`BadInput` where it cannot be
    written.
    """
    save(draw_figure(names, rows, marks, title), path)


def draw_figure(names: Sequence[str], rows: Sequence[Row], marks: Sequence[Mark], title: str) -> Figure:
    """From the first that moves to the last that does. Raises :class:`BadConfig` without matplotlib."""
    rows = without_rest(rows)
    marks = [mark for mark in marks if rows[0].t <= mark.t <= rows[-1].t]
    figure, above, heights, ways = axes_of(title)
    times = [row.t for row in rows]
    plot(names, rows, above, heights, ways)
    look_down(above, rows)
    for axes in (heights, ways):
        axes.set_xlim(times[0], times[-1])
    if len(names) <= NAMED:
        above.legend(fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, frameon=False, handlelength=1.0)
    for axes in (heights, ways):
        for mark in marks:
            axes.axvline(mark.t, color="#9aa0a6", lw=0.6, ls=":")
    return figure


def without_rest(rows: Sequence[Row]) -> Sequence[Row]:
    """Those from shortly before the first moves to shortly after the last has come to rest; all where nobody moves."""
    away = [k for k, row in enumerate(rows) if _moved(rows[0], row)]
    going = [k for k, row in enumerate(rows) if _moved(rows[-1], row)]
    if not away or not going:
        return rows
    begin, end = rows[away[0]].t - STILL, rows[going[-1]].t + STILL
    return [row for row in rows if begin <= row.t <= end]


def plot(names: Sequence[str], rows: Sequence[Row], above: Any, heights: Any, ways: Any) -> None:
    """Everybody's track, height and way from the first of the ``rows`` to the last."""
    from matplotlib import colormaps

    times = [row.t for row in rows]
    for i, name in enumerate(names):
        shade = colormaps["turbo"]((i + 0.5) / len(names))
        north, east, up = ([row.places[i][axis] for row in rows] for axis in (0, 1, 2))
        wide = 1.0 + 2.0 * (1.0 - (i + 1) / len(names)) if len(names) <= NAMED else 1.0  # ways may lie on one another
        above.plot(east, north, color=shade, lw=wide, label=name)
        above.plot(east[:1], north[:1], "o", color=shade, ms=4, mfc="white")
        above.plot(east[-1:], north[-1:], "o", color=shade, ms=4)
        heights.plot(times, up, color=shade, lw=1.0)
        way = [math.hypot(n - north[0], e - east[0]) for n, e in zip(north, east, strict=True)]
        ways.plot(times, way, color=shade, lw=1.0)


def _moved(first: Row, now: Row) -> bool:
    return any(math.dist(a, b) > STIRRED for a, b in zip(first.places, now.places, strict=True))


def look_down(above: Any, rows: Sequence[Row]) -> None:
    """All of it from above, and as much in both directions as the axes have room for."""
    corners = []
    for axis in (1, 0):
        values = [place[axis] for row in rows for place in row.places]
        middle, half = (max(values) + min(values)) / 2, max(0.56 * (max(values) - min(values)), LEAST / 2)
        corners.append((middle - half, middle + half))
    above.update_datalim(list(zip(*corners, strict=True)))
    above.margins(0.0)
    above.autoscale_view()


def axes_of(title: str) -> tuple[Figure, Any, Any, Any]:
    """From above; and over time the heights and the ways over the ground."""
    needs("the picture", "planner", "matplotlib.figure")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic([["above", "heights"], ["above", "ways"]], width_ratios=(1.0, 1.15))
    above, heights, ways = axes["above"], axes["heights"], axes["ways"]
    above.set(xlabel="east, m", ylabel="north, m")
    above.set_aspect("equal", adjustable="datalim")
    heights.set(ylabel="height, m")
    ways.set(xlabel="time, s", ylabel="way from start, m")
    for each in (above, heights, ways):
        each.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10)
    return figure, above, heights, ways
