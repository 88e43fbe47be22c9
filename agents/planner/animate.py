"""A plan as it would be flown, in Rerun: in a window, or as a recording in a file."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from agents.planner.model.plans import Plan
from agents.planner.model.scene import Box, Cylinder, NoFly, Scene
from agents.planner.model.verify import Report
from agents.planner.picture import colours, place_of
from zmav.errors import BadConfig

RATE = 10.0
"""pictures a second of the plan"""
ROUND = 24
"""corners of a drawn cylinder"""
GREY, ORANGE, GREEN, RED = (150, 155, 160), (232, 113, 10), (24, 128, 56), (217, 48, 37)


def show(scene: Scene, plan: Plan, report: Report | None, save: Path | None, window: bool) -> None:
    """Log the plan into a file, a window of Rerun's, or both.

    Time 0 is the start of the plan; the red line is the pair that comes nearest to each other, while it is near.
    Raises :class:`BadConfig` where there is no viewer, or it goes away.
    """
    recording = rr.RecordingStream("zmav plan", recording_id=None)
    sinks: list[Any] = []
    if save is not None:
        sinks.append(rr.FileSink(str(save)))
    if window:
        sinks.append(rr.GrpcSink())
    try:
        if window:
            rr.spawn(connect=False, hide_welcome_screen=True, executable_path=program(), recording=recording)
        recording.set_sinks(*sinks)
        recording.send_blueprint(_blueprint())
        _log_world(recording, scene)
        _log_vehicles(recording, scene, plan, report)
        recording.flush()
    except RuntimeError as e:
        text = f"the plan cannot be shown: {str(e).strip().splitlines()[0]}"
        raise BadConfig(text, field="view", value=None, expected="Rerun's viewer, of zmav[viz]") from e
    finally:
        recording.disconnect()


def program() -> str | None:
    """Rerun's viewer: beside this Python, also where that is not on the path; None: there is none."""
    places = (str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath))
    return shutil.which("rerun", path=os.pathsep.join(places))


def _blueprint() -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Spatial3DView(origin="/", name="plan", background=[248, 249, 250]),
        rrb.TimePanel(timeline="plan", state="expanded", play_state="playing", loop_mode="all"),
        collapse_panels=True,
    )


def _log_world(recording: rr.RecordingStream, scene: Scene) -> None:
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    solid = [each for each in scene.obstacles if isinstance(each, Box)]
    if solid:
        middles = [[(a + b) / 2 for a, b in zip(each.min, each.max, strict=True)] for each in solid]
        halves = [[(b - a) / 2 for a, b in zip(each.min, each.max, strict=True)] for each in solid]
        boxes = rr.Boxes3D(centers=middles, half_sizes=halves, colors=[(*GREY, 110)], fill_mode="solid")
        recording.log("world/boxes", boxes, static=True)
    for k, each in enumerate(scene.obstacles):
        if isinstance(each, Box):
            continue
        shade = ORANGE if isinstance(each, NoFly) else GREY
        strips = edges(outline(each), each.floor, each.ceiling)
        recording.log(f"world/{k}", rr.LineStrips3D(strips, colors=shade, radii=rr.Radius.ui_points(1.0)), static=True)
    if scene.geofence is not None:
        fence = edges(scene.geofence.polygon, scene.geofence.floor, scene.geofence.ceiling)
        recording.log("world/fence", rr.LineStrips3D(fence, colors=GREEN, radii=rr.Radius.ui_points(1.5)), static=True)
    low, high = np.array(scene.bounds.min), np.array(scene.bounds.max)
    bounds = rr.Boxes3D(
        centers=[(low + high) / 2], half_sizes=[(high - low) / 2], colors=GREY, fill_mode="majorwireframe"
    )
    recording.log("world/bounds", bounds, static=True)


def outline(each: Cylinder | NoFly) -> list[tuple[float, float]]:
    """The corners over the ground, many for a round one."""
    if isinstance(each, NoFly):
        return each.polygon
    angle = np.arange(ROUND) / ROUND * 2.0 * np.pi
    x, y = each.center[0] + each.radius * np.cos(angle), each.center[1] + each.radius * np.sin(angle)
    return list(zip(x.tolist(), y.tolist(), strict=True))


def edges(corners: list[tuple[float, float]], floor: float, ceiling: float) -> list[list[tuple[float, float, float]]]:
    """An upright body's rims and uprights."""
    rim = [*corners, corners[0]]
    rims = [[(x, y, z) for x, y in rim] for z in (floor, ceiling)]
    return [*rims, *([(x, y, floor), (x, y, ceiling)] for x, y in corners)]


def _log_vehicles(recording: rr.RecordingStream, scene: Scene, plan: Plan, report: Report | None) -> None:
    motions = plan.motions()
    flown = [v for v in scene.vehicles if v.id in motions]
    shades = [tuple(int(255 * part) for part in colour) for colour in colours(len(flown))]
    radii = [v.radius for v in flown]
    tracks = [motions[v.id][:, 1:] for v in flown]
    lines = rr.LineStrips3D(tracks, colors=[(*s, 90) for s in shades], radii=rr.Radius.ui_points(1.0))
    recording.log("tracks", lines, static=True)
    goals = rr.Ellipsoids3D(
        centers=[track[-1] for track in tracks], radii=radii, colors=[(*s, 160) for s in shades], line_radii=0.02
    )
    recording.log("goals", goals, static=True)
    for t in np.arange(0.0, plan.makespan + 1.0 / RATE, 1.0 / RATE):
        recording.set_time("plan", duration=float(t))
        here = [place_of(motions[v.id], float(t)) for v in flown]
        there = [k for k, v in enumerate(flown) if v.type != "plane" or t <= motions[v.id][-1, 0]]
        labels = [flown[k].id for k in there] if len(flown) <= 64 else None
        points = rr.Points3D(
            [here[k] for k in there], radii=[radii[k] for k in there], colors=[shades[k] for k in there], labels=labels
        )
        recording.log("vehicles", points)
        if report is not None and report.closest is not None and all(name in motions for name in report.closest.ids):
            near = abs(t - report.closest.time) < 1.0
            pair = [[place_of(motions[name], float(t)) for name in report.closest.ids]] if near else []
            words = [f"{report.closest.clearance:.2f} m clear"] if near else None
            strip = rr.LineStrips3D(pair, colors=RED, radii=rr.Radius.ui_points(3.0), labels=words)
            recording.log("nearest", strip)
