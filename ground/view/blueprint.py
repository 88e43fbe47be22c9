"""How the viewer is laid out at first sight: the fleet large on the left, plots beside it, words and pictures below."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from ground.view.signals import PLOTS
from zmav.wire import Vector

SPAN = 60.0
"""s that the plots show"""
FLIGHT = (
    ("error", "Tracking error, m"),
    ("height", "Height above the origin, m"),
    ("speed", "Speed, m/s"),
    ("battery", "Battery, %"),
)
LINKS = (
    ("age", "Age of the last state, s"),
    ("delay", "Delay of states, ms"),
    ("rtt", "Round trip, ms"),
    ("loss", "Loss, %"),
)
NARROW, WIDE = 15.0, 300.0
"""m: the least and the largest radius of a fleet that the view is made to fit"""


def blueprint(places: Sequence[Vector] = ()) -> rrb.Blueprint:
    """The layout; ``places`` (NED) of the vehicles say where to look from. It holds for one vehicle as for fifty: it
    names none of them.
    """
    scene = rrb.Spatial3DView(
        origin="/world",
        name="Fleet",
        background=(16, 20, 27),
        line_grid=rrb.LineGrid3D(visible=True, spacing=10.0, stroke_width=1.0, color=(90, 100, 115, 90)),
        eye_controls=eye(places),
    )
    plots = rrb.Tabs(
        rrb.Vertical(*(_plot(what, name) for what, name in FLIGHT), name="Flight"),
        rrb.Vertical(*(_plot(what, name) for what, name in LINKS), name="Links"),
        rrb.Vertical(*(_plot(f"controllers/{what}", name) for what, name in PLOTS.items()), name="Controllers"),
        active_tab=0,
    )
    below = rrb.Horizontal(
        rrb.TextLogView(
            origin="/events", name="Events", columns=rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
        ),
        rrb.Spatial2DView(origin="/camera", name="Camera"),
        column_shares=[3, 4],
    )
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(scene, below, row_shares=[7, 3]), plots, column_shares=[5, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _plot(what: str, name: str) -> rrb.TimeSeriesView:
    latest = rrb.VisibleTimeRange(
        "time", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-SPAN), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.TimeSeriesView(
        origin=f"/plots/{what}",
        name=name,
        time_ranges=latest,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_y=rrb.ScalarAxis(range=(0.0, 100.0)) if what == "battery" else None,
    )


def eye(places: Sequence[Vector]) -> rrb.EyeControls3D | None:
    """From the south-west and above, so that most of ``places`` are seen; None where there are none yet."""
    if not places:
        return None
    north, east, down = (statistics.median(place[axis] for place in places) for axis in range(3))
    up = -down
    distances = sorted(math.dist(place, (north, east, down)) for place in places)
    around = distances[round(0.8 * (len(distances) - 1))]  # one that is far away must not make all others small
    away = 1.6 * min(max(around, NARROW), WIDE)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=(east - 0.65 * away, north - away, up + 0.7 * away),
        look_target=(east, north, up),
        eye_up=(0.0, 0.0, 1.0),
    )


def fixed(recording: rr.RecordingStream) -> None:
    """What the scene stands on: the axes of the view, and the one change of frame (see :mod:`ground.view.frames`)."""
    from ground.view.frames import NED_IN_VIEW

    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("world/ned", rr.Transform3D(mat3x3=NED_IN_VIEW), static=True)
