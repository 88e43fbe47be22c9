"""A flight over its reference as a picture: the way in space, and the error along time with the corners marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from agents.navigator.path import Array
from agents.navigator.tracking import Errors, errors, summarise
from agents.navigator.trajectory import Trajectory
from zmav.errors import BadInput, missing_extra
from zmav.figures import save

REFERENCE, CORNER = "#5f6368", "#e8710a"
FLOWN = ("#1a73e8", "#188038", "#a142f4", "#d93025")
Flight = tuple[npt.ArrayLike, npt.ArrayLike]
"""times (N,) s since the trajectory's beginning, positions (N, 3) m NED"""


def picture(path: str | Path, flights: Mapping[str, Flight], trajectory: Trajectory, title: str = "") -> None:
    """Draw flights of one trajectory, by what they are called, into a file (png, svg or pdf).

    Raises :class:`~zmav.errors.BadInput` where it cannot be written or nothing was flown of the route,
    :class:`~zmav.errors.BadConfig` where matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as e:
        raise missing_extra("the picture", "matplotlib", "planner") from e
    path, found = Path(path), {name: errors(*flight, trajectory) for name, flight in flights.items()}
    for name, each in found.items():
        if not len(each.t):
            raise BadInput(f"{name}: no position is on the route", field="flights", value=name, expected="some")
    figure = Figure(figsize=(12.0, 5.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.25))
    _space(figure.add_subplot(grid[:, 0], projection="3d"), flights, trajectory)
    over = figure.add_subplot(grid[0, 1])
    _time(over, found, trajectory, "from the reference, m", lambda each: each.size)
    under = figure.add_subplot(grid[1, 1], sharex=over)
    _time(under, found, trajectory, "off the way, m", lambda each: each.cross)
    under.set_xlabel("time, s (dotted: at a corner)")
    lines = [f"{name}: {summarise(each, trajectory.route)}" for name, each in found.items()]
    figure.suptitle("\n".join([title, *lines] if title else lines), fontsize=9)
    save(figure, path)


def _space(ax: Any, flights: Mapping[str, Flight], trajectory: Trajectory) -> None:
    route = trajectory.route
    total = route.begins + route.length
    meant = route.at(np.linspace(route.begins, total, max(2, round(total / 0.05))))[0]
    ax.plot(*_shown(meant), color=REFERENCE, lw=2.4, alpha=0.6, label="reference")
    ax.scatter(*_shown(route.at(route.corners)[0]), color=CORNER, s=18, label="corners")
    for (name, (times, positions)), shade in zip(flights.items(), FLOWN * len(flights), strict=False):
        t, places = np.asarray(times, dtype=float), np.asarray(positions, dtype=float).reshape(-1, 3)
        mine = (t >= trajectory.begins) & (t <= trajectory.duration)
        ax.plot(*_shown(places[mine]), color=shade, lw=1.1, label=name)
    ax.set(xlabel="east, m", ylabel="north, m", zlabel="up, m")
    low, high = _shown(meant).min(axis=1), _shown(meant).max(axis=1)
    ax.set_box_aspect(tuple(np.maximum(high - low, 0.25 * float((high - low).max()))), zoom=0.85)
    ax.legend(loc="upper left", fontsize=8)


def _time(
    ax: Any, found: Mapping[str, Errors], trajectory: Trajectory, label: str, value: Callable[[Errors], Array]
) -> None:
    for at in trajectory.corners[0]:
        ax.axvline(at, color=CORNER, lw=0.9, ls=":")
    for (name, each), shade in zip(found.items(), FLOWN * len(found), strict=False):
        ax.plot(each.t, value(each), color=shade, lw=1.0, label=name)
    ax.set(ylabel=label, ylim=(0.0, None))
    ax.grid(alpha=0.3)
    if len(found) > 1:
        ax.legend(loc="upper right", fontsize=8)


def _shown(places: Array) -> Array:
    """(3, N) east, north and up of (N, 3) NED."""
    return np.array([places[:, 1], places[:, 0], -places[:, 2]])
