"""A judge of plans that shares nothing with the planner: scene and plan as plain JSON, numpy and shapely.

Obstacles are looked at in points 2 cm apart on the track; pairs of vehicles by the closed form between all instants at
which either has a sample. It is slow, and meant to be read.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 0.02
"""m"""


def check(scene: dict[str, Any], plan: dict[str, Any]) -> set[tuple[str, str]]:
    """What is wrong, as (kind, vehicle's id); for a pair both are named. Empty: it is a plan."""
    wrong: set[tuple[str, str]] = set()
    tracks: dict[str, Array] = {}
    for vehicle in scene["vehicles"]:
        name = vehicle["id"]
        samples = plan["trajectories"].get(name)
        if not samples:
            wrong.add(("missing", name))
            continue
        track = np.array(samples, dtype=float)
        if track.shape[1:] != (4,) or not np.isfinite(track).all() or (np.diff(track[:, 0]) <= 0).any():
            wrong.add(("samples", name))
            continue
        tracks[name] = track
        wrong |= {(kind, name) for kind in _alone(scene, vehicle, track)}
    wrong |= {("unknown", name) for name in plan["trajectories"] if name not in {v["id"] for v in scene["vehicles"]}}
    return wrong | _at_goals(scene, tracks) | _together(scene, tracks)


def _alone(scene: dict[str, Any], vehicle: dict[str, Any], track: Array) -> set[str]:
    """The rules that each keeps by itself."""
    wrong = set()
    if np.abs(track - np.round(track, 6)).max() > 1e-9:
        wrong.add("decimals")
    if track[0, 0] != 0.0 or np.abs(track[0, 1:] - vehicle["start"]).max() > 1e-5:
        wrong.add("start")
    if track[-1, 0] > scene.get("time_limit", math.inf):
        wrong.add("late")
    plane = vehicle["type"] == "plane"
    dt = np.diff(track[:, 0])
    velocity = np.diff(track[:, 1:], axis=0) / dt[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    if (speed > vehicle["vmax"] * 1.02 + 1e-5).any():
        wrong.add("speed")
    if (velocity[:, 2] > vehicle.get("vz_up", np.inf) * 1.02 + 1e-5).any():
        wrong.add("climb")
    if (velocity[:, 2] < -vehicle.get("vz_down", np.inf) * 1.02 - 1e-5).any():
        wrong.add("descent")
    if plane and (speed < vehicle["vmin"] * 0.98 - 1e-5).any():
        wrong.add("slow")
    if plane and len(velocity):
        heading = math.degrees(math.atan2(velocity[0, 1], velocity[0, 0]))
        if abs((heading - vehicle["start_heading_deg"] + 180.0) % 360.0 - 180.0) > 5.0:
            wrong.add("heading")
    if ((speed * dt > 1e-4) & (dt > 0.2 + 1e-5)).any():
        wrong.add("sampling")
    middles = (track[:-1, 0] + track[1:, 0]) / 2.0
    if not plane and len(velocity):
        # At rest before the first sample and after the last.
        velocity = np.vstack(([0.0, 0.0, 0.0], velocity, [0.0, 0.0, 0.0]))
        middles = np.concatenate(([track[0, 0]], middles, [track[-1, 0]]))
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / np.diff(middles)
    if (change > vehicle["amax"] * 1.05 + 0.05 + 1e-4).any():
        wrong.add("acceleration")
    if vehicle["type"] == "rover" and np.abs(track[:, 3] - vehicle["start"][2]).max() > 0.01:
        wrong.add("height")
    return wrong | _in_the_world(scene, vehicle, track)


def _in_the_world(scene: dict[str, Any], vehicle: dict[str, Any], track: Array) -> set[str]:
    wrong = set()
    places = track[:, 1:]
    low, high = np.array(scene["bounds"]["min"]), np.array(scene["bounds"]["max"])
    if (places < low - 0.01).any() or (places > high + 0.01).any():
        wrong.add("bounds")
    fence = scene.get("geofence")
    if fence:
        level = (places[:, 2] < fence["floor"] - 0.01) | (places[:, 2] > fence["ceiling"] + 0.01)
        ground = places[:, :2] if len(places) > 1 else np.repeat(places[:, :2], 2, axis=0)
        if level.any() or not shapely.Polygon(fence["polygon"]).buffer(0.01).covers(shapely.LineString(ground)):
            wrong.add("fence")
    points = dense(places)
    need = vehicle["radius"] - 0.01
    for obstacle in scene["obstacles"]:
        low, high = extent(obstacle)
        near = ((points > low - need) & (points < high + need)).all(axis=1)
        if (distances(obstacle, points[near]) < need).any():
            wrong.add("obstacle")
    return wrong


def extent(obstacle: dict[str, Any]) -> tuple[Array, Array]:
    """The box around an obstacle."""
    if obstacle["type"] == "box":
        return np.array(obstacle["min"]), np.array(obstacle["max"])
    if obstacle["type"] == "cylinder":
        middle, radius = np.array(obstacle["center"]), obstacle["radius"]
        low, high = middle - radius, middle + radius
    else:
        low, high = np.min(obstacle["polygon"], axis=0), np.max(obstacle["polygon"], axis=0)
    return np.append(low, obstacle["floor"]), np.append(high, obstacle["ceiling"])


def dense(places: Array) -> Array:
    """(M, 3): points along a track, neighbours no further apart than STEP."""
    parts = [places[:1]]
    for a, b in itertools.pairwise(places):
        count = max(1, math.ceil(float(np.linalg.norm(b - a)) / STEP))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.vstack(parts)


def distances(obstacle: dict[str, Any], points: Array) -> Array:
    """(M,): how far points are from an obstacle, 0 inside."""
    if obstacle["type"] == "box":
        nearest = np.clip(points, obstacle["min"], obstacle["max"])
        return np.asarray(np.linalg.norm(points - nearest, axis=1))
    if obstacle["type"] == "cylinder":
        flat = np.maximum(0.0, np.linalg.norm(points[:, :2] - obstacle["center"], axis=1) - obstacle["radius"])
    else:
        polygon = shapely.Polygon(obstacle["polygon"])
        flat = shapely.distance(polygon, shapely.points(points[:, :2]))
    level = points[:, 2] - np.clip(points[:, 2], obstacle["floor"], obstacle["ceiling"])
    return np.asarray(np.hypot(flat, level))


def _at_goals(scene: dict[str, Any], tracks: dict[str, Array]) -> set[tuple[str, str]]:
    reach = scene["goal_tolerance"] + 1e-6
    if scene["assignment"] == "labelled":
        return {
            ("goal", v["id"])
            for v in scene["vehicles"]
            if v["id"] in tracks and math.dist(tracks[v["id"]][-1, 1:], v["goal"]) > reach
        }
    free = [tuple(goal) for goal in scene["goals"]]
    wrong = set()
    for name, track in tracks.items():  # tolerances are smaller than half of what goals are apart
        near = [goal for goal in free if math.dist(track[-1, 1:], goal) <= reach]
        if near:
            free.remove(near[0])
        else:
            wrong.add(("goal", name))
    return wrong


def _together(scene: dict[str, Any], tracks: dict[str, Array]) -> set[tuple[str, str]]:
    """Anyone who comes nearer to another than both radii."""
    vehicles = {v["id"]: v for v in scene["vehicles"]}
    wrong: set[tuple[str, str]] = set()
    if len(tracks) < 2:
        return wrong
    # Rough first: where all are every 0.1 s. Nobody moves further than its speed allows in between.
    end = max(track[-1, 0] for track in tracks.values())
    times = np.arange(0.0, end + 0.1, 0.1)
    names = list(tracks)
    rough = np.stack([at(tracks[name], times) for name in names]) / [1.0, 1.0, scene["downwash"]]
    fastest = [float(np.linalg.norm(np.diff(r, axis=0), axis=1).max(initial=0.0)) for r in rough]
    for i, j in itertools.combinations(range(len(names)), 2):
        one, other = names[i], names[j]
        need = vehicles[one]["radius"] + vehicles[other]["radius"] - 0.01
        if np.linalg.norm(rough[i] - rough[j], axis=1).min() > need + fastest[i] + fastest[j]:
            continue
        if apart(scene, vehicles[one], vehicles[other], tracks[one], tracks[other]) < need:
            wrong |= {("separation", one), ("separation", other)}
    return wrong


def at(track: Array, times: Array) -> Array:
    """(M, 3): where it is; held before the first sample and after the last."""
    return np.stack([np.interp(times, track[:, 0], track[:, k]) for k in (1, 2, 3)], axis=1)


def apart(scene: dict[str, Any], a: dict[str, Any], b: dict[str, Any], one: Array, other: Array) -> float:
    """The least scaled distance while both are there."""
    end = max(one[-1, 0], other[-1, 0])
    for vehicle, track in ((a, one), (b, other)):
        if vehicle["type"] == "plane":
            end = min(end, track[-1, 0])
    times = np.union1d(one[:, 0], other[:, 0])
    times = np.append(times[times < end], end)
    difference = (at(one, times) - at(other, times)) / [1.0, 1.0, scene["downwash"]]
    begin, way = difference[:-1], np.diff(difference, axis=0)
    square = (way**2).sum(axis=1)
    share = np.clip(-(begin * way).sum(axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    nearest = np.linalg.norm(begin + share[:, None] * way, axis=1)
    return float(min(nearest.min(initial=np.inf), np.linalg.norm(difference, axis=1).min()))
