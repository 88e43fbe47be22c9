"""Scenes (``swarm-scene/1``): vehicles with starts and goals in a world of obstacles, as a JSON file or made live.

Local ENU metres, z up, angles of headings in degrees counter-clockwise from east.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

Point = tuple[float, float, float]
Corner = tuple[float, float]
FORMAT = "swarm-scene/1"


class Vehicle(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One vehicle; metres, m/s, m/s² (the norm of the vector in three dimensions).

    Planes start and end flying, and leave the scene after their last sample; rovers stay at their start's height.
    """

    id: str
    type: Literal["copter", "rover", "plane"]
    start: Point
    goal: Point | None = None
    """None where the scene's ``goals`` are anybody's (unlabelled)"""
    radius: float
    vmax: float
    amax: float
    vz_up: float | None = None
    vz_down: float | None = None
    vmin: float | None = None
    """planes only"""
    start_heading_deg: float | None = None
    """planes only"""


class Box(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, tag="box"):
    min: Point
    max: Point


class Cylinder(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, tag="cylinder"):
    center: Corner
    radius: float
    floor: float
    ceiling: float


class NoFly(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, tag="no_fly"):
    """A prism: any simple polygon, either way round."""

    polygon: list[Corner]
    floor: float
    ceiling: float


Obstacle = Box | Cylinder | NoFly
"""a centre stays a vehicle's ``radius`` away from each"""


class Bounds(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The centre stays inside."""

    min: Point
    max: Point


class Fence(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The centre stays inside."""

    polygon: list[Corner]
    floor: float
    ceiling: float


class Scene(msgspec.Struct, kw_only=True):
    """What is to be planned. Fields that this version does not know are left alone."""

    format: str = FORMAT
    name: str = ""
    vehicles: list[Vehicle]
    assignment: Literal["labelled", "unlabelled"] = "labelled"
    goals: list[Point] | None = None
    """unlabelled: one for each vehicle, whichever gets it"""
    obstacles: list[Obstacle] = []
    bounds: Bounds
    geofence: Fence | None = None
    downwash: float = 1.0
    """c: two vehicles keep sqrt(dx² + dy² + (dz/c)²) >= r_i + r_j at every instant"""
    goal_tolerance: float = 0.5
    time_limit: float | None = None
    """s by which the last trajectory ends; None: none"""
    lower_bound: dict[str, Any] | None = None
