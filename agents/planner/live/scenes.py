"""A scene of what is: vehicles where they are, the world as told, and everybody else as something to keep clear of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from agents.planner.goals.steps import GROUND, WINGED, FleetView, VehicleView
from agents.planner.live.fleet import FRESH, HeardVehicle
from agents.planner.live.frames import enu, vector
from agents.planner.live.world import Pieces
from agents.planner.model import scene
from agents.planner.model.ground import Floor
from agents.planner.model.problem import Floats, MovingObstacle
from zmav.wire import Vector

OVER = 10.0
"""m above the highest ground that there is room for"""
GOES_ON = 8.0
"""s for which what is at another's command goes on as it does"""
DEPTH = 50.0
"""m below the lowest vehicle to which the column below one that is not heard goes"""


@dataclass(frozen=True)
class Room:
    """The surroundings of the vehicles of one goal."""

    obstacles: tuple[scene.Obstacle, ...]
    movers: tuple[MovingObstacle, ...]
    pieces: Pieces
    downwash: float
    floor: Floor | None
    """None: nothing is known of the ground, and nothing asked"""

    def empty(self, points: Sequence[Vector], starts: Sequence[Vector] = ()) -> scene.Scene:
        """The scene without vehicles, as large as needed for these places (ENU). From ``starts`` one may climb that is
        too low there.
        """
        bounds, columns = self.pieces.bounds(points), list[scene.Obstacle]()
        if self.floor is not None and points:
            bounds = self._over(bounds, self.floor)
            columns += self.floor.columns(bounds, starts, points)
        return scene.Scene(
            vehicles=[],
            obstacles=[*self.obstacles, *columns],
            bounds=bounds,
            geofence=self.pieces.geofence,
            downwash=self.downwash,
        )

    def _over(self, bounds: scene.Bounds, floor: Floor) -> scene.Bounds:
        """High enough for ways over all that is known, below the ceiling and the fence's."""
        (x, y, top), fence = bounds.max, self.pieces.geofence
        peak = floor.peak([bounds.min[:2], bounds.max[:2]])
        wanted = top if peak is None else peak + OVER
        over = min(floor.ceiling, math.inf if fence is None else fence.ceiling, wanted)
        return msgspec.structs.replace(bounds, max=(x, y, max(top, over)))


def room_of(
    vehicles: Sequence[str],
    fleet: Sequence[HeardVehicle],
    pieces: Pieces,
    walls: Sequence[scene.Obstacle],
    spoken_for: set[str],
    downwash: float,
    floor: Floor | None,
) -> Room:
    """Everything but ``vehicles``: who rests is a mover at rest, who is not heard has the column below its place.

    ``walls``: what other goals have spoken for; ``spoken_for``: the vehicles that are within it.
    """
    obstacles = [*pieces.obstacles, *walls]
    for seen in fleet:
        view = seen.view
        if view.name not in vehicles and _lost(seen):
            x, y, z = enu(view.pos_ned)
            radius, top = view.body.radius, z + view.body.radius * downwash
            name = f"what {view.name} may need, which is not heard"
            obstacles.append(scene.Cylinder(center=(x, y), radius=radius, floor=z - DEPTH, ceiling=top, name=name))
    return Room(tuple(obstacles), tuple(moving(vehicles, fleet, pieces, spoken_for)), pieces, downwash, floor)


def moving(
    vehicles: Sequence[str], fleet: Sequence[HeardVehicle], pieces: Pieces, spoken_for: set[str]
) -> list[MovingObstacle]:
    """What moves or rests by itself, from now: told of, or vehicles that are heard and nobody's here."""
    others = [seen.view for seen in fleet if not _lost(seen)]
    return [
        *pieces.movers,
        *(
            MovingObstacle(view.name, _motion_of(view), view.body.radius)
            for view in others
            if view.name not in vehicles and view.name not in spoken_for
        ),
    ]


def _lost(seen: HeardVehicle) -> bool:
    """In the air when last heard, and not heard now."""
    return seen.age >= FRESH and seen.view.airborne


def _motion_of(view: VehicleView) -> Floats:
    """Where it stays; or goes on as it does for a while, where it moves at somebody else's command."""
    x, y, z = enu(view.pos_ned)
    u, v, w = enu(view.vel_ned)
    if u * u + v * v + w * w < 0.25:
        u = v = w = 0.0
    return np.array([(t, x + u * t, y + v * t, z + w * t) for t in (0.0, GOES_ON)], dtype=np.float64)


def scene_of(
    views: Sequence[VehicleView], places: Floats, labelled: bool, room: Room, also: Sequence[Vector] = ()
) -> scene.Scene:
    """From where they are to ``places`` (N, 3) ENU. Rovers keep their height. ``also``: what the bounds are to hold."""
    starts = [enu(view.pos_ned) for view in views]
    goals = [vector(place) for place in places]
    if labelled:
        goals = [
            (g[0], g[1], s[2]) if view.kind in GROUND else g for view, s, g in zip(views, starts, goals, strict=True)
        ]
    empty = room.empty([*starts, *goals, *also], starts)
    vehicles = [_vehicle(view, s, g if labelled else None) for view, s, g in zip(views, starts, goals, strict=True)]
    if labelled:
        return msgspec.structs.replace(empty, vehicles=vehicles)
    return msgspec.structs.replace(empty, vehicles=vehicles, assignment="unlabelled", goals=goals)


def _vehicle(view: VehicleView, start: Vector, goal: Vector | None) -> scene.Vehicle:
    body = view.body
    kind: Literal["copter", "rover", "plane"]
    kind = "rover" if view.kind in GROUND else "plane" if view.kind in WINGED else "copter"
    return scene.Vehicle(
        id=view.name,
        type=kind,
        start=start,
        goal=goal,
        radius=body.radius,
        vmax=body.speed,
        amax=view.accel,
        vz_up=body.climb,
        vz_down=body.descend,
        vmin=body.min_speed if kind == "plane" else None,
    )


def resized(view: FleetView, radii: Mapping[str, float], share: float = 1.0) -> FleetView:
    """The fleet with these radii, where one is told, and all at that share of their speed."""

    def other(each: VehicleView) -> VehicleView:
        radius = radii.get(each.name, each.body.radius)
        return replace(each, body=msgspec.structs.replace(each.body, radius=radius, speed=each.body.speed * share))

    return FleetView({name: other(each) for name, each in view.vehicles.items()})


def moved(view: FleetView, places: Mapping[str, Vector], airborne: bool | None = None) -> FleetView:
    """The fleet as it will be when these have come to places (NED), at rest."""
    vehicles = dict(view.vehicles)
    for name, place in places.items():
        old = vehicles[name]
        flies = (old.airborne if airborne is None else airborne) and old.flies
        vehicles[name] = replace(old, pos_ned=place, vel_ned=(0.0, 0.0, 0.0), airborne=flies)
    return FleetView(vehicles)
