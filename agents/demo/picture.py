"""The picture of a demo: tracks from above, heights over time with the story's steps; and the same as an animation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zmav.errors import BadConfig, BadInput
from zmav.figures import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from agents.demo.play import Mark
    from agents.demo.truth import Row

NAMED = 12
"""tracks that get a name each; more are a crowd"""
MOST_MARKS = 40
"""words that have room beside each other"""
STIRRED = 0.3
"""m that a vehicle has moved when an animation begins"""
FRAMES, PACE = 150, 0.08
"""of an animation: pictures, and s of each"""
TAIL = 60
"""rows of track behind each vehicle in an animation"""


def draw(names: Sequence[str], rows: Sequence[Row], marks: Sequence[Mark], title: str, path: Path) -> None:
    """PNG, SVG or PDF by the name. Raises :class:`BadConfig` without matplotlib, :class:`BadInput` where it cannot be
    written.
    """
    figure, above, heights, ways = _figure(title)
    shades = _shades(len(names))
    times = [row.t for row in rows]
    for i, name in enumerate(names):
        north, east, up = ([row.places[i][axis] for row in rows] for axis in (0, 1, 2))
        above.plot(east, north, color=shades[i], lw=1.2, label=name)
        above.plot(east[:1], north[:1], "o", color=shades[i], ms=4, mfc="white")
        above.plot(east[-1:], north[-1:], "o", color=shades[i], ms=4)
        heights.plot(times, up, color=shades[i], lw=1.0)
        ways.plot(times, [math.hypot(n - north[0], e - east[0]) for n, e in zip(north, east, strict=True)],
                  color=shades[i], lw=1.0)  # fmt: skip
    if len(names) <= NAMED:
        above.legend(fontsize=7, loc="best")
    _mark(heights, ways, marks, times)
    save(figure, path)


def animate(names: Sequence[str], rows: Sequence[Row], title: str, path: Path, frames: int = FRAMES) -> None:
    """A .gif of the tracks from above and of the heights, from the first that moves on, faster than it was flown."""
    figure, above, heights, ways = _figure(title)
    from matplotlib.animation import FuncAnimation, PillowWriter

    begin = next((k for k, row in enumerate(rows) if _moved(rows[0], row)), 0)
    rows = rows[max(begin - 5, 0) :]
    shades = _shades(len(names))
    norths, easts, ups = ([place[axis] for row in rows for place in row.places] for axis in (0, 1, 2))
    room = 0.06 * max(max(norths) - min(norths), max(easts) - min(easts), 5.0)
    above.set(xlim=(min(easts) - room, max(easts) + room), ylim=(min(norths) - room, max(norths) + room))
    far = max(_off(rows[0], row, i) for row in rows for i in range(len(names)))
    for axes, top in ((heights, max(ups)), (ways, far)):
        axes.set(xlim=(rows[0].t, rows[-1].t), ylim=(-0.03 * top - 0.3, 1.1 * top + 0.5))
    dots = [above.plot([], [], "o", color=shade, ms=6 if len(names) <= NAMED else 4)[0] for shade in shades]
    tails = [above.plot([], [], color=shade, lw=1.0, alpha=0.7)[0] for shade in shades]
    ups_ = [heights.plot([], [], color=shade, lw=1.0)[0] for shade in shades]
    offs = [ways.plot([], [], color=shade, lw=1.0)[0] for shade in shades]

    def show(frame: int) -> list[Any]:
        k = round(frame * (len(rows) - 1) / (frames - 1))
        tail, before = rows[max(k - TAIL, 0) : k + 1], rows[: k + 1]
        times = [row.t for row in before]
        for i in range(len(names)):
            dots[i].set_data([rows[k].places[i][1]], [rows[k].places[i][0]])
            tails[i].set_data([row.places[i][1] for row in tail], [row.places[i][0] for row in tail])
            ups_[i].set_data(times, [row.places[i][2] for row in before])
            offs[i].set_data(times, [_off(rows[0], row, i) for row in before])
        return [*dots, *tails, *ups_, *offs]

    figure.set_dpi(60)
    try:
        FuncAnimation(figure, show, frames=frames, blit=False).save(str(path), writer=PillowWriter(fps=round(1 / PACE)))
    except (OSError, ValueError) as e:
        raise BadInput(f"cannot draw {path}: {e}", field="animation", value=str(path), expected="a .gif") from e


def _moved(first: Row, now: Row) -> bool:
    return any(math.dist(a, b) > STIRRED for a, b in zip(first.places, now.places, strict=True))


def _off(first: Row, now: Row, i: int) -> float:
    """m over the ground from where it began."""
    return math.hypot(now.places[i][0] - first.places[i][0], now.places[i][1] - first.places[i][1])


def _mark(heights: Any, ways: Any, marks: Sequence[Mark], times: Sequence[float]) -> None:
    """A dotted line for each step; words where there is room for them."""
    top, last, room = heights.get_ylim()[1], -math.inf, (times[-1] - times[0]) / MOST_MARKS
    for mark in marks:
        for axes in (heights, ways):
            axes.axvline(mark.t, color="#9aa0a6", lw=0.6, ls=":")
        if mark.t - last >= room:
            heights.text(mark.t, top, f" {mark.text}", rotation=90, va="top", fontsize=6, color="#5f6368", clip_on=True)
            last = mark.t


def _figure(title: str) -> tuple[Figure, Any, Any, Any]:
    """From above; and over time the heights and the ways over the ground."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as e:
        text = "the picture needs matplotlib: pip install 'zmav[planner]'"
        raise BadConfig(text, field="picture", value=e.name, expected="matplotlib") from e
    figure = Figure(figsize=(11.0, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic([["above", "heights"], ["above", "ways"]], width_ratios=(1.0, 1.15))
    above, heights, ways = axes["above"], axes["heights"], axes["ways"]
    above.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    heights.set(ylabel="height, m")
    ways.set(xlabel="time, s", ylabel="way from start, m")
    for each in (above, heights, ways):
        each.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10)
    return figure, above, heights, ways


def _shades(count: int) -> list[Any]:
    from matplotlib import colormaps

    return [colormaps["turbo"]((i + 0.5) / count) for i in range(count)]
