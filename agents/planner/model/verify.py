"""The last word on a plan: is every rule of its scene kept, at every instant? No plan leaves without this.

Distances between two vehicles and from obstacles are exact along the straight pieces, not sampled. Nothing of the
search's geometry is used, so that a mistake there cannot pass here. ENU metres and seconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from agents.planner.model import exact
from agents.planner.model.problem import Floats, Motion, MovingObstacle
from agents.planner.model.scene import Scene, Vehicle, name_of
from agents.planner.model.separation import all_pairs

FaultKind = Literal[
    "missing",
    "unknown",
    "samples",
    "start",
    "goal",
    "heading",
    "speed",
    "climb",
    "descent",
    "slow",
    "acceleration",
    "sampling",
    "height",
    "bounds",
    "fence",
    "obstacle",
    "separation",
    "late",
    "decimals",
]


@dataclass(frozen=True)
class Fault:
    """One rule that is broken, where it is broken most."""

    kind: FaultKind
    ids: tuple[str, ...]
    time: float | None
    """s, when"""
    amount: float | None
    """by how much: m, m/s, m/s² or s over what is allowed"""
    text: str

    def __str__(self) -> str:
        return self.text


DISTANCE, SPEED, ACCELERATION = 0.01, 0.02, 0.05
"""what the format lets pass: m nearer to others and to obstacles or outside of bounds and fence; a share; a share, and
m/s² besides"""
FAR = 1e12
"""no number of a sample is so large"""


@dataclass(frozen=True)
class Closest:
    """Where two vehicles (or a vehicle and a mover) are nearest, measured by what their radii leave between them."""

    ids: tuple[str, str]
    time: float
    clearance: float
    """m: the scaled distance less the radii"""


@dataclass(frozen=True)
class Report:
    """What the verifier found."""

    faults: tuple[Fault, ...]
    makespan: float
    """s until the last vehicle is at its goal"""
    closest: Closest | None
    """None: there is no pair"""
    obstacle_clearance: float
    """m: the least distance from an obstacle, less the radius; inf: there is none"""
    goals: dict[str, int] = field(default_factory=dict)
    """unlabelled: which of the scene's goals each vehicle reached"""

    @property
    def ok(self) -> bool:
        return not self.faults

    @property
    def clearance(self) -> float:
        """m: the least distance of two vehicles, less their radii; inf: there is no pair."""
        return math.inf if self.closest is None else self.closest.clearance

    def culprits(self) -> list[str]:
        """Every vehicle that a fault names, in the order of the faults."""
        return list(dict.fromkeys(each for fault in self.faults for each in fault.ids))


def verify(
    scene: Scene,
    trajectories: Mapping[str, Motion | Sequence[Sequence[float]]],
    movers: Sequence[MovingObstacle] = (),
    *,
    written: bool = False,
) -> Report:
    """Judge trajectories by vehicle's id, each (T, 4) t, x, y, z.

    ``movers`` are kept clear of, and not judged themselves. ``written``: the numbers are those of a plan file, with
    six decimals. Raises nothing for a bad plan, whatever is in it: that is what the report is for.
    """
    faults: list[Fault] = []
    motions = _motions(scene, trajectories, written, faults)
    flown = [v for v in scene.vehicles if v.id in motions]
    for vehicle in flown:
        faults += _ends(scene, vehicle, motions[vehicle.id])
        faults += _limits(vehicle, motions[vehicle.id])
        faults += _inside(scene, vehicle, motions[vehicle.id])
    goals, wrong = _goals(scene, flown, motions)
    faults += wrong
    clearance = _obstacles(scene, flown, motions, faults)
    closest = _apart(scene, flown, motions, movers, faults)
    makespan = max((float(motion[-1, 0]) for motion in motions.values()), default=0.0)
    return Report(tuple(faults), makespan, closest, clearance, goals)


def _motions(
    scene: Scene, trajectories: Mapping[str, Motion | Sequence[Sequence[float]]], written: bool, faults: list[Fault]
) -> dict[str, Motion]:
    """Those that are motions at all, as arrays."""
    known = {v.id for v in scene.vehicles}
    for name in trajectories:
        if name not in known:
            faults.append(Fault("unknown", (name,), None, None, f"the scene has no vehicle {name}"))
    motions = {}
    for v in scene.vehicles:
        if v.id not in trajectories:
            faults.append(Fault("missing", (v.id,), None, None, f"{v.id} has no trajectory"))
            continue
        try:
            motion = np.ascontiguousarray(trajectories[v.id], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            motion = np.empty(0)
        if motion.ndim != 2 or motion.shape[1] != 4 or not len(motion) or not (np.abs(motion) < FAR).all():
            faults.append(Fault("samples", (v.id,), None, None, f"{v.id}: samples are numbers t, x, y, z, one or more"))
            continue
        back = np.flatnonzero(np.diff(motion[:, 0]) <= 0.0)
        if len(back):
            t = float(motion[back[0] + 1, 0])
            faults.append(Fault("samples", (v.id,), t, None, f"{v.id}: time does not go on at {t:g} s"))
            continue
        off = np.abs(motion - np.round(motion, 6)).max() if written else 0.0
        if off > 1e-9:
            text = f"{v.id}: a sample has more than six decimals"
            faults.append(Fault("decimals", (v.id,), None, float(off), text))
        motions[v.id] = motion
    return motions


def _ends(scene: Scene, v: Vehicle, motion: Motion) -> list[Fault]:
    """From the start, within the time, and a plane on its heading."""
    faults = []
    away = math.dist(motion[0, 1:], v.start)
    if away > 1e-5:
        text = f"{v.id} begins {away:.3g} m from its start"
        faults.append(Fault("start", (v.id,), 0.0, away, text))
    if abs(motion[0, 0]) > 1e-6:
        t = float(motion[0, 0])
        faults.append(Fault("start", (v.id,), t, abs(t), f"{v.id} begins at {t:g} s, not at 0"))
    end = float(motion[-1, 0])
    if scene.time_limit is not None and end > scene.time_limit:
        text = f"{v.id} arrives at {end:.3f} s, after the time limit of {scene.time_limit:g} s"
        faults.append(Fault("late", (v.id,), end, end - scene.time_limit, text))
    if v.type == "plane" and v.start_heading_deg is not None and len(motion) > 1:
        dx, dy = motion[1, 1:3] - motion[0, 1:3]
        off = abs(math.degrees(math.remainder(math.atan2(dy, dx) - math.radians(v.start_heading_deg), math.tau)))
        if off > 5.0:
            text = f"{v.id} starts {off:.1f}° off its heading of {v.start_heading_deg:g}°"
            faults.append(Fault("heading", (v.id,), 0.0, off, text))
    return faults


def _limits(v: Vehicle, motion: Motion) -> list[Fault]:
    """Speed, climb, acceleration, and how densely it is sampled."""
    found = exact.limits(motion, v.type != "plane")
    more = 1.0 + SPEED
    up = v.vmax if v.vz_up is None else v.vz_up
    down = v.vmax if v.vz_down is None else v.vz_down
    most = v.amax * (1.0 + ACCELERATION) + ACCELERATION
    rules: list[tuple[FaultKind, float, float, str]] = [
        ("speed", found[0, 0], v.vmax * more, "flies {:.3f} m/s, {:.3f} are allowed"),
        ("climb", found[1, 0], up * more, "climbs {:.3f} m/s, {:.3f} are allowed"),
        ("descent", found[2, 0], down * more, "descends {:.3f} m/s, {:.3f} are allowed"),
        ("acceleration", found[3, 0], most, "accelerates by {:.3f} m/s², {:.3f} are allowed"),
        ("sampling", found[4, 0], 0.2, "is {:.3f} s without a sample while it moves, {:.3f} are allowed"),
    ]
    faults = []
    for k, (kind, value, limit, words) in enumerate(rules):
        if value > limit + 2e-6:
            t = float(motion[int(found[k, 1]), 0])
            text = f"{v.id} " + words.format(value, limit) + f", at {t:.2f} s"
            faults.append(Fault(kind, (v.id,), t, value - limit, text))
    least = (v.vmin or 0.0) * (1.0 - SPEED)
    if v.type == "plane" and (len(motion) < 2 or found[5, 0] < least - 2e-6):
        t = float(motion[int(found[5, 1]), 0])
        slow = float(found[5, 0]) if len(motion) > 1 else 0.0
        text = f"{v.id} flies {slow:.3f} m/s at {t:.2f} s, a plane needs {least:.3f}"
        faults.append(Fault("slow", (v.id,), t, least - slow, text))
    if v.type == "rover":
        off = np.abs(motion[:, 3] - v.start[2])
        if off.max() > DISTANCE:
            k = int(off.argmax())
            text = f"{v.id} is {off[k]:.3f} m off its height, at {motion[k, 0]:.2f} s"
            faults.append(Fault("height", (v.id,), float(motion[k, 0]), float(off[k]), text))
    return faults


def _inside(scene: Scene, v: Vehicle, motion: Motion) -> list[Fault]:
    """Within the bounds and the fence."""
    faults: list[Fault] = []

    def outside(kind: FaultKind, words: str, depth: float, k: int) -> None:
        if depth > DISTANCE:
            t = float(motion[k, 0])
            text = f"{v.id} is {depth:.3f} m outside of the {words}, at {t:.2f} s"
            faults.append(Fault(kind, (v.id,), t, depth, text))

    place = motion[:, 1:]
    over = np.maximum(np.array(scene.bounds.min) - place, place - np.array(scene.bounds.max)).max(axis=1)
    outside("bounds", "bounds", float(over.max()), int(over.argmax()))
    if scene.geofence is not None:
        fence = scene.geofence
        level = np.maximum(fence.floor - place[:, 2], place[:, 2] - fence.ceiling)
        outside("fence", "geofence (floor or ceiling)", float(level.max()), int(level.argmax()))
        depth, piece = exact.out_of_fence(motion, np.array(fence.polygon, dtype=np.float64))
        outside("fence", "geofence", float(depth), int(piece))
    return faults


def _goals(scene: Scene, flown: Sequence[Vehicle], motions: Mapping[str, Motion]) -> tuple[dict[str, int], list[Fault]]:
    """Whether each ends at its goal, or all at different ones of the scene's goals."""
    faults = []
    reach = scene.goal_tolerance + 1e-9
    if scene.assignment == "labelled" or scene.goals is None:
        for v in flown:
            away = math.inf if v.goal is None else math.dist(motions[v.id][-1, 1:], v.goal)
            if away > reach:
                t = float(motions[v.id][-1, 0])
                text = f"{v.id} ends {away:.3f} m from its goal, {scene.goal_tolerance:g} are allowed"
                faults.append(Fault("goal", (v.id,), t, away - scene.goal_tolerance, text))
        return {}, faults
    if not flown:
        return {}, faults
    from scipy.sparse import csr_matrix  # takes long to import and is seldom needed
    from scipy.sparse.csgraph import maximum_bipartite_matching

    ends = np.array([motions[v.id][-1, 1:] for v in flown]).reshape(-1, 3)
    way = np.linalg.norm(ends[:, None] - np.array(scene.goals, dtype=np.float64)[None], axis=2)
    got = maximum_bipartite_matching(csr_matrix(way <= reach), perm_type="column").tolist()
    for k, v in enumerate(flown):
        if got[k] < 0:
            text = f"{v.id} ends at no goal that is not another's ({way[k].min():.3f} m from the nearest)"
            faults.append(Fault("goal", (v.id,), float(motions[v.id][-1, 0]), float(way[k].min()), text))
    return {v.id: goal for v, goal in zip(flown, got, strict=True) if goal >= 0}, faults


def _obstacles(scene: Scene, flown: Sequence[Vehicle], motions: Mapping[str, Motion], faults: list[Fault]) -> float:
    """The least clearance from obstacles; those that are hit are added to the faults."""
    if not scene.obstacles:
        return math.inf
    solids = exact.solids_of(scene)
    best = math.inf
    for v in flown:
        motion = motions[v.id]
        distance, which, piece = exact.from_solids(motion, *solids, v.radius + max(best, 0.0))
        if which < 0:
            continue
        best = min(best, float(distance) - v.radius)
        if distance < v.radius - DISTANCE:
            t = float(motion[piece, 0])
            text = f"{v.id} is {distance:.3f} m from {name_of(scene, which)}, {v.radius:g} are needed, at {t:.2f} s"
            faults.append(Fault("obstacle", (v.id,), t, v.radius - float(distance), text))
    return best


def _apart(
    scene: Scene,
    flown: Sequence[Vehicle],
    motions: Mapping[str, Motion],
    movers: Sequence[MovingObstacle],
    faults: list[Fault],
) -> Closest | None:
    """The pair with the least clearance; those that are too near are added to the faults."""
    names = [*(v.id for v in flown), *(m.id for m in movers)]
    radius: Floats = np.array([*(v.radius for v in flown), *(m.radius for m in movers)], dtype=np.float64)
    tracks = [*(motions[v.id] for v in flown), *(np.ascontiguousarray(m.motion) for m in movers)]
    leaves = [*(v.type == "plane" for v in flown), *(m.leaves for m in movers)]
    found, (i, j, clearance, when) = all_pairs(tracks, radius, leaves, scene.downwash, len(flown), DISTANCE)
    for a, b, distance, t in found:
        one, other = int(a), int(b)
        need = float(radius[one] + radius[other])
        text = f"{names[one]} and {names[other]} are {distance:.3f} m apart, {need:g} are needed, at {t:.2f} s"
        faults.append(Fault("separation", (names[one], names[other]), float(t), need - float(distance), text))
    return None if i < 0 else Closest((names[i], names[j]), when, clearance)
