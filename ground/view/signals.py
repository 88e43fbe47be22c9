"""What controllers and other agents stream: each number a line in the plots of the tab "Controllers".

The names are those of ``agent/{agent}/out/{topic}`` (docs/controllers.md): ``is.x`` is measured and ``ref.x`` asked
for, so both are drawn in one plot, the reference as a thin, dark line in the broad, bright one of what is.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import rerun as rr

from ground.view import style
from ground.view.canvas import Canvas, Path
from zmav import wire
from zmav.errors import BadInput, ZmavError

PLOTS = {
    "position": "Position, m: x red, y green, z blue",
    "velocity": "Velocity, m/s: x red, y green, z blue",
    "attitude": "Attitude, rad: roll red, pitch green, yaw blue",
    "rates": "Rates, rad/s: p red, q green, r blue",
    "outputs": "Outputs",
    "others": "Other signals",
    "cycle": "Cycle: time taken, µs; how many were late",
}
"""the plots' paths and their names; legends would cover them"""
MOST_STREAMS, MOST_SIGNALS = 40, 300
"""topics of agents that are drawn, and signals of each"""
LARGEST = 64_000
"""bytes of a sample: the most signals with the longest names have less"""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:-]{0,59}")
AXES: dict[str, style.Colour] = {"x": (255, 95, 85, 255), "y": (105, 220, 95, 255), "z": (95, 160, 255, 255)}
"""of the first axis, the second and the third, whatever they are called"""
_CHANNELS = {
    channel: (plot, axis)
    for plot, channels in {
        "position": ("x", "y", "z"),
        "velocity": ("vx", "vy", "vz"),
        "attitude": ("roll", "pitch", "yaw"),
        "rates": ("p", "q", "r"),
    }.items()
    for channel, axis in zip(channels, AXES, strict=True)
}
_LONG = {"reference": "", "reference_vel": "v"}


class PlotLine(NamedTuple):
    """Where one signal is drawn, and how."""

    plot: str
    title: str
    colour: style.Colour
    reference: bool = False


def line_of(name: str) -> PlotLine:
    """The line of the signal ``name``: a controller's, or a reference that the navigator calls ``reference.x``."""
    kind, _, channel = name.partition(".")
    if kind in _LONG:
        kind, channel = "ref", _LONG[kind] + channel
    if kind in ("is", "ref") and channel in _CHANNELS:
        plot, axis = _CHANNELS[channel]
        return PlotLine(plot, channel if kind == "is" else f"{channel} ref", AXES[axis], kind == "ref")
    if kind == "out" and channel:
        return PlotLine("outputs", channel, AXES.get(channel.rpartition(".")[2], style.colour(channel)))
    return PlotLine("cycle" if name in ("took_us", "late") else "others", name, style.colour(name), kind == "ref")


class Signals:
    """Draws the newest sample of every stream; each line is styled once, when its signal is first heard of."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, ...], dict[str, Path]] = {}
        """by fleet, vehicle, agent and topic: the paths of the signals that are drawn"""

    def take(self, canvas: Canvas, place: tuple[str, ...], label: str, payload: bytes) -> int:
        """Draw a sample of the stream at ``place``, whose vehicle is called ``label``; how many of its signals cannot
        be drawn, for their names, their number or because they are no numbers. Raises :class:`ZmavError` for one that
        cannot be drawn at all.
        """
        if len(payload) > LARGEST:
            raise BadInput(f"{len(payload)} bytes of signals", field="out", value=len(payload), expected=f"{LARGEST}")
        sample = wire.decode(payload, wire.Signals, "signals")
        paths = self._streams.get(place)
        if paths is None:
            if len(self._streams) >= MOST_STREAMS:
                raise ZmavError(f"more than {MOST_STREAMS} streams of signals are not drawn")
            paths = self._streams[place] = {}
        _, _, agent, topic = place
        who = f"{label} {agent}" if topic == "signals" else f"{label} {agent} {topic}"
        left_out = 0
        for name, value in sample.values.items():
            path = paths.get(name)
            if path is None and len(paths) < MOST_SIGNALS and NAME.fullmatch(name):
                path = paths[name] = self._begin(canvas, place, who, name)
            if path is None or not math.isfinite(value):
                left_out += 1
            else:
                canvas.put(path, rr.Scalars(value))
        return left_out

    def _begin(self, canvas: Canvas, place: tuple[str, ...], who: str, name: str) -> Path:
        line = line_of(name)
        path = ("plots", "controllers", line.plot, who, name)
        shade = style.turned(line.colour, list(self._streams).index(place))
        canvas.fixed(
            path,
            rr.SeriesLines(
                colors=style.darkened(shade) if line.reference else shade,
                widths=1.0 if line.reference else 2.5,
                names=f"{who} {line.title}",
            ),
        )
        return path
