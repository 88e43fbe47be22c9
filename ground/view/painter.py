"""The process that draws: it asks for what has changed, ten times a second at most, and logs it to one Rerun sink.

``python -m ground.view.painter SETTINGS``: started by :mod:`ground.view.screen`, and ended with it. On standard output
it writes one byte whenever it is ready for more; on standard input comes a batch in answer, with its length before it.
Where its sink takes nothing any more, it asks no more: nothing heaps up anywhere, and who started it need not wait.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import statistics
import struct
import sys
import threading
import time
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import BinaryIO

import msgspec
import rerun as rr
import rerun.blueprint as rrb

from ground.view.canvas import Canvas
from ground.view.frames import NED_IN_VIEW
from ground.view.scene import Scene
from ground.view.screen import LENGTH, LOST, READY, PainterSettings, Sink
from ground.view.signals import PLOTS
from ground.view.table import Batch
from ground.view.viewer import start_viewer
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


def blueprint(places: Sequence[Vector] = (), tab: int = 0) -> rrb.Blueprint:
    """The layout; ``places`` (NED) of the vehicles say where to look from, ``tab`` which of the plots are in front. It
    holds for one vehicle as for fifty: it names none of them.
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
        active_tab=tab,
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


def log_axes(recording: rr.RecordingStream) -> None:
    """What the scene stands on: the axes of the view, and the one change of frame (see :mod:`ground.view.frames`)."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("world/ned", rr.Transform3D(mat3x3=NED_IN_VIEW), static=True)


PERIOD, CROWDED = 0.1, 0.2
"""s between two steps at least, and where there are many vehicles"""
FLUSH_VIEWER, FLUSH_FILE = 0.2, 2.0
"""s that logged rows may wait for others: a killed painter leaves a file without the last of them"""
CHECK = 5.0
"""s between two looks whether the sink still takes what is logged"""
SETTLE = 3.0
"""s from the first vehicle's appearance until the view is fitted to the fleet, once"""


def main() -> None:
    settings = msgspec.json.decode(sys.argv[1], type=PainterSettings)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who started us: the pipe's end tells us
    requests = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no request
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    recording = rr.RecordingStream("zmav", batcher_config=_batcher(settings.sink))
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)
    viewer = start_viewer(settings.sink) if settings.sink.kind in ("native", "web") else None
    _connect(recording, settings.sink)
    canvas = Canvas(recording)
    painting = Painting(recording, canvas, Scene(canvas, settings.several, settings.size))
    proof = Proof(recording, settings.sink)
    while viewer is None or viewer.poll() is None:
        began = time.monotonic()
        batch = _fetch(requests, sys.stdin.buffer)
        if batch is None:
            break
        logged = painting.step(batch, time.monotonic(), time.time())
        if not proof.holds(logged, time.monotonic()):
            os._exit(LOST)
        time.sleep(max(0.0, (CROWDED if painting.scene.crowded else PERIOD) - (time.monotonic() - began)))
    with contextlib.suppress(Exception):  # the sink may be gone
        recording.flush(timeout_sec=2.0)
        recording.disconnect()
    if viewer is not None and viewer.poll() is None:
        viewer.terminate()
    os._exit(0)  # Rerun would wait for a sink that takes nothing


class Painting:
    """The scene, step by step, and the layout at its beginning."""

    def __init__(self, recording: rr.RecordingStream, canvas: Canvas, scene: Scene) -> None:
        self._recording, self.canvas, self.scene = recording, canvas, scene
        self._fit_at: float | None = None
        self._fitted = False
        log_axes(recording)
        recording.send_blueprint(blueprint())

    def step(self, batch: Batch, now: float, t: float) -> int:
        """Draw what came; how many paths were logged."""
        self.scene.apply(batch)
        self.scene.paint(now, t)
        if not self._fitted:
            self._fit(now)
        return self.canvas.flush(t)

    def _fit(self, now: float) -> None:
        places = [craft.position for craft in self.scene.crafts.values() if craft.position is not None]
        if not places:
            return
        self._fit_at = now + SETTLE if self._fit_at is None else self._fit_at
        if now >= self._fit_at:
            self._fitted = True
            self._recording.send_blueprint(blueprint(places))


class Proof:
    """Looks now and then whether a file grows: Rerun goes on logging into nothing when the disk is full."""

    def __init__(self, recording: rr.RecordingStream, sink: Sink) -> None:
        self._recording, self._sink = recording, sink
        self._at, self._logged, self._size, self._still = time.monotonic(), 0, -1, 0

    def holds(self, logged: int, now: float) -> bool:
        """``logged``: how much was logged since the last call. False: nothing arrives, and nothing will."""
        self._logged += logged
        if self._sink.kind != "save" or now - self._at < CHECK:
            return True
        self._at, logged, self._logged = now, self._logged, 0
        with contextlib.suppress(RuntimeError):
            self._recording.flush(timeout_sec=3.0)
        self._still = self._still + 1 if logged and not self._grown() else 0
        return self._still < 2

    def _grown(self) -> bool:
        before = self._size
        try:
            self._size = Path(self._sink.path).stat().st_size
        except OSError:
            return False
        return self._size > before


def _batcher(sink: Sink) -> rr.ChunkBatcherConfig:
    """Rows of a path that go together: each chunk costs a kilobyte, whatever it holds."""
    config = rr.ChunkBatcherConfig.DEFAULT()
    config.flush_tick = timedelta(seconds=FLUSH_FILE if sink.kind == "save" else FLUSH_VIEWER)
    return config


def _connect(recording: rr.RecordingStream, sink: Sink) -> None:
    if sink.kind == "save":
        recording.save(sink.path)
    else:
        recording.connect_grpc(sink.url)


def _fetch(requests: BinaryIO, answers: BinaryIO) -> Batch | None:
    """Ask for what has changed; None when nobody answers any more."""
    try:
        requests.write(READY)
        head = answers.read(LENGTH.size)
        if len(head) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack(head)
        data = answers.read(length)
        return msgspec.msgpack.decode(data, type=Batch) if len(data) == length else None
    except (OSError, struct.error, msgspec.DecodeError):
        return None


def _end_with_parent(parent: int) -> None:
    """End, viewer included, soon after who started us has: the main thread may be waiting for a sink for ever."""
    while os.getppid() == parent:
        time.sleep(1.0)
    time.sleep(3.0)  # for a file to be written to its end
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
