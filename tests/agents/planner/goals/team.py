"""Fleets and open ground for the tests of goals, and a judge of the steps that come out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agents.planner.goals import formation
from agents.planner.goals.dealing import Part
from agents.planner.goals.steps import FleetView, Fly, PlanTo, Step, VehicleView
from agents.planner.live import frames
from agents.planner.model import verify
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.scene import Bounds, Box, Fence, Obstacle, Scene, Vehicle
from agents.planner.solve.pipeline import solve
from zmav import wire
from zmav.config.body import USUAL
from zmav.wire.base import Vector

DOWNWASH = 1.5
OPEN = Bounds(min=(-150.0, -150.0, 0.0), max=(250.0, 250.0, 60.0))
GATE: list[Obstacle] = [
    Box(min=(-1.0, -150.0, 0.0), max=(1.0, -2.5, 60.0)),
    Box(min=(-1.0, 2.5, 0.0), max=(1.0, 250.0, 60.0)),
    Box(min=(-1.0, -2.5, 0.0), max=(1.0, 2.5, 7.5)),
    Box(min=(-1.0, -2.5, 12.5), max=(1.0, 2.5, 60.0)),
]
"""a window of 5 x 5 m about (0, 0, 10) in a wall across x = 0"""


def view(name: str, pos_ned: Vector, kind: str = "copter", airborne: bool = True, **body: float) -> VehicleView:
    able, home = USUAL[kind], (pos_ned[0], pos_ned[1], 0.0)
    numbers = {field: body.get(field, getattr(able, field)) for field in able.__struct_fields__}
    return VehicleView(name, kind, wire.swarm.Body(**numbers), pos_ned, airborne=airborne, home_ned=home)


def team(count: int, at: Vector = (-40.0, -40.0, -10.0), apart: float = 5.0, **body: float) -> FleetView:
    """Copters in rows of eight, NED."""
    north, east, down = at
    views = [
        view(f"v{i:03}", (north - apart * (i // 8), east + apart * (i % 8), down), **body)  # type: ignore[arg-type]
        for i in range(count)
    ]
    return FleetView({each.name: each for each in views})


def ground(obstacles: Sequence[Obstacle] = (), fence: Fence | None = None, bounds: Bounds = OPEN) -> Scene:
    return Scene(vehicles=[], obstacles=list(obstacles), bounds=bounds, geofence=fence, downwash=DOWNWASH)


def scene_of(fleet: FleetView, names: Sequence[str], starts: Floats, goals: Floats, world: Scene) -> Scene:
    vehicles = []
    for name, start, goal in zip(names, starts, goals, strict=True):
        one = fleet.vehicles[name]
        vehicles.append(
            Vehicle(
                id=name,
                type="rover" if one.kind == "rover" else "copter",
                start=point(start),
                goal=point(goal),
                radius=one.body.radius,
                vmax=one.body.speed,
                amax=one.body.accel,
                vz_up=one.body.climb,
                vz_down=one.body.descend,
            )
        )
    return Scene(
        vehicles=vehicles,
        obstacles=world.obstacles,
        bounds=world.bounds,
        geofence=world.geofence,
        downwash=world.downwash,
    )


def point(values: Floats) -> tuple[float, float, float]:
    x, y, z = map(float, np.round(values, 6))
    return (x, y, z)


def judge_fly(fly: Fly, fleet: FleetView, world: Scene, motions: dict[str, Motion] | None = None) -> verify.Report:
    flown = dict(fly.motions) if motions is None else motions
    names = list(flown)
    starts = np.array([flown[name][0, 1:] for name in names])
    goals = np.array([flown[name][-1, 1:] for name in names])
    return verify.verify(scene_of(fleet, names, starts, goals, world), flown)


def lasting(fly: Fly) -> float:
    """s"""
    return max(float(motion[-1, 0]) for motion in fly.motions.values())


def positions(fleet: FleetView, names: Sequence[str]) -> Floats:
    return frames.enu_array(np.array([fleet.vehicles[name].pos_ned for name in names]))


def fly_all(steps: Sequence[Step], fleet: FleetView, world: Scene, seconds: float = 120.0) -> float:
    """Plan and verify every step in turn; gives the time that all take. Raises where one cannot be done."""
    now = {name: positions(fleet, [name])[0] for name in fleet.vehicles}
    took = 0.0
    for step in steps:
        if isinstance(step, PlanTo):
            starts = np.array([now[name] for name in step.vehicles])
            scene = scene_of(fleet, step.vehicles, starts, step.places, world)
            if not step.labelled:
                scene.assignment, scene.goals = "unlabelled", [point(p) for p in step.places]
                for vehicle in scene.vehicles:
                    vehicle.goal = None
            plan = solve(scene, seconds=seconds)
            for name, samples in plan.trajectories.items():
                now[name] = np.array(samples[-1][1:])
            took += plan.makespan
        elif isinstance(step, Fly):
            for name, motion in step.motions.items():
                assert np.allclose(motion[0, 1:], now[name], atol=1e-3), (name, motion[0], now[name])
                now[name] = motion[-1, 1:]
            report = judge_fly(step, fleet, world)
            assert report.ok, report.faults[:5]
            took += report.makespan
    return took


def shape_error(offsets: Floats, tracks: Floats) -> Floats:
    """(T,) RMS metres from the ideal shape, moved and turned to fit best, of (T, N, 3) positions at common times."""
    shape = formation.placed(offsets, np.zeros(3), 0.0)
    a = shape - shape.mean(axis=0)
    b = tracks - tracks.mean(axis=1, keepdims=True)
    cross = np.sum(a[None, :, 0] * b[:, :, 1] - a[None, :, 1] * b[:, :, 0], axis=1)
    dot = np.sum(a[None, :, 0] * b[:, :, 0] + a[None, :, 1] * b[:, :, 1], axis=1)
    course = np.arctan2(cross, dot)[:, None]
    east = a[:, 0] * np.cos(course) - a[:, 1] * np.sin(course)
    north = a[:, 0] * np.sin(course) + a[:, 1] * np.cos(course)
    ideal = np.stack((east, north, np.broadcast_to(a[:, 2], east.shape)), axis=2)
    errors: Floats = np.sqrt(np.mean(np.sum((ideal - b) ** 2, axis=2), axis=1))
    return errors


def nearest(points: Floats, downwash: float) -> tuple[float, int, int]:
    """The least distance of two of (N, 3) points, and which two; inf, 0, 0 for a single one."""
    if len(points) < 2:
        return math.inf, 0, 0
    apart = formation.scaled_distances(points, points, downwash)
    np.fill_diagonal(apart, np.inf)
    one, other = divmod(int(np.argmin(apart)), len(points))
    return float(apart[one, other]), min(one, other), max(one, other)


def balance(parts: Sequence[Part]) -> float:
    """The longest time of a search's parts over the mean of those that have one."""
    times = [part.seconds for part in parts if len(part.path)]
    return max(times) / (sum(times) / len(times))
