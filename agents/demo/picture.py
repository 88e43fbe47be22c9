"""The picture of a demo: tracks from above, heights over time with the story's steps; and the same as an animation."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zmav.errors import BadConfig, BadInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from agents.demo.play import Mark
    from agents.demo.truth import Row

NAMED = 12
"""tracks that get a name each; more are a crowd"""
MOST_MARKS = 14
FRAMES, PACE = 150, 0.08
"""of an animation: pictures, and s of each"""
TAIL = 25
"""rows of track behind each vehicle in an animation"""


def draw(names: Sequence[str], rows: Sequence[Row], marks: Sequence[Mark], title: str, path: Path) -> None:
    """PNG, SVG or PDF by the name. Raises :class:`BadConfig` without matplotlib, :class:`BadInput` where it cannot be
    written.
    """
    figure, above, beside = _figure(title)
    shades = _shades(len(names))
    for i, name in enumerate(names):
        north, east, up = ([row.places[i][axis] for row in rows] for axis in (0, 1, 2))
        above.plot(east, north, color=shades[i], lw=1.2, label=name)
        above.plot(east[:1], north[:1], "o", color=shades[i], ms=4, mfc="white")
        above.plot(east[-1:], north[-1:], "o", color=shades[i], ms=4)
        beside.plot([row.t for row in rows], up, color=shades[i], lw=1.0)
    if len(names) <= NAMED:
        above.legend(fontsize=7, loc="best")
    top = beside.get_ylim()[1]
    for mark in list(marks)[:MOST_MARKS]:
        beside.axvline(mark.t, color="#9aa0a6", lw=0.6, ls=":")
        beside.text(mark.t, top, f" {mark.text}", rotation=90, va="top", ha="left", fontsize=5.5, color="#5f6368")
    beside.set(xlabel="time, s", ylabel="height, m")
    _save(figure, path)


def animate(names: Sequence[str], rows: Sequence[Row], title: str, path: Path) -> None:
    """A .gif of the tracks from above and of the heights, faster than it was flown."""
    figure, above, beside = _figure(title)
    from matplotlib.animation import FuncAnimation, PillowWriter

    shades = _shades(len(names))
    norths = [place[0] for row in rows for place in row.places]
    easts = [place[1] for row in rows for place in row.places]
    room = 0.06 * max(max(norths) - min(norths), max(easts) - min(easts), 5.0)
    above.set(xlim=(min(easts) - room, max(easts) + room), ylim=(min(norths) - room, max(norths) + room))
    beside.set(xlim=(0.0, rows[-1].t), ylim=(-1.0, 1.1 * max(place[2] for row in rows for place in row.places) + 1.0),
               xlabel="time, s", ylabel="height, m")  # fmt: skip
    dots = [above.plot([], [], "o", color=shade, ms=6 if len(names) <= NAMED else 4)[0] for shade in shades]
    tails = [above.plot([], [], color=shade, lw=1.0, alpha=0.7)[0] for shade in shades]
    heights = [beside.plot([], [], color=shade, lw=1.0)[0] for shade in shades]

    def show(frame: int) -> list[Any]:
        k = round(frame * (len(rows) - 1) / (FRAMES - 1))
        tail, before = rows[max(k - TAIL, 0) : k + 1], rows[: k + 1]
        for i in range(len(names)):
            dots[i].set_data([rows[k].places[i][1]], [rows[k].places[i][0]])
            tails[i].set_data([row.places[i][1] for row in tail], [row.places[i][0] for row in tail])
            heights[i].set_data([row.t for row in before], [row.places[i][2] for row in before])
        return [*dots, *tails, *heights]

    figure.set_dpi(60)
    try:
        FuncAnimation(figure, show, frames=FRAMES, blit=False).save(str(path), writer=PillowWriter(fps=round(1 / PACE)))
    except (OSError, ValueError) as e:
        raise BadInput(f"cannot draw {path}: {e}", field="animation", value=str(path), expected="a .gif") from e


def _figure(title: str) -> tuple[Figure, Any, Any]:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as e:
        text = "the picture needs matplotlib: pip install 'zmav[planner]'"
        raise BadConfig(text, field="picture", value=e.name, expected="matplotlib") from e
    figure = Figure(figsize=(11.0, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    above, beside = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    above.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    above.grid(alpha=0.3)
    beside.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10)
    return figure, above, beside


def _shades(count: int) -> list[Any]:
    from matplotlib import colormaps

    return [colormaps["turbo"]((i + 0.5) / count) for i in range(count)]


def _save(figure: Figure, path: Path) -> None:
    data = io.BytesIO()
    try:
        figure.savefig(data, format=path.suffix.lstrip(".").lower() or "png")
        path.write_bytes(data.getvalue())
    except (ValueError, OSError) as e:
        expected = "a .png, .svg or .pdf in a folder that exists"
        raise BadInput(f"cannot draw {path}: {e}", field="picture", value=str(path), expected=expected) from e
