"""What a goal comes down to: each kind of goal as steps, or the typed error of one that cannot be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from agents.planner.goals import pads, slots
from agents.planner.goals.follow import offsets_of
from agents.planner.goals.formation import check_apart, formation
from agents.planner.goals.steps import FleetView, Loiter, PlanTo, Step, Stop, Track, VehicleView
from agents.planner.goals.sweeping import search
from agents.planner.live import frames
from agents.planner.live.checks import check_numbers
from agents.planner.model.geometry import outside, segment_clear, world_of
from agents.planner.model.ground import NAME as GROUND
from agents.planner.model.ground import Floor
from agents.planner.model.scene import Obstacle, Scene
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.validate import distance
from agents.planner.model.world import World
from zmav import wire
from zmav.errors import BadInput
from zmav.wire import Vector

ROUND = 49
"""points of a circle that are looked at, the last one the first"""


def resolve(
    goal: wire.swarm.Goal,
    fleet: FleetView,
    scene: Scene,
    static: StaticMap | None = None,
    floor: Floor | None = None,
) -> list[Step]:
    """The steps of a goal, one after another.

    ``scene`` holds no vehicles: obstacles, bounds, fence, downwash. ``static`` is what is known of it from before,
    ``floor`` how low vehicles may be above the ground where that is known.
    Raises :class:`~zmav.errors.BadInput` naming the field, :class:`~zmav.errors.Refused` naming vehicles that stand on
    the ground and must not, :class:`~zmav.errors.Unsupported` naming those that cannot do it at all.
    """
    check_numbers(goal, "goal")
    views = fleet.pick(goal.vehicles)
    if static is None:
        static = StaticMap(world_of(scene))
    if isinstance(goal, wire.swarm.GoTo):
        return _circles_fit(_goto(goal, views, scene.downwash), fleet, static.world, "to")
    if isinstance(goal, wire.swarm.Formation):
        return formation(goal, views, scene.downwash, static)
    if isinstance(goal, wire.swarm.Search):
        return search(goal, views, scene, floor)
    if isinstance(goal, wire.swarm.Follow):
        return _follow(goal, views, fleet, scene.downwash)
    if isinstance(goal, wire.swarm.TakeOff):
        return pads.takeoff(views, goal.height, scene.downwash, _free(static.world, scene.obstacles))
    if isinstance(goal, wire.swarm.Land):
        return pads.land(views, goal.at, scene.downwash, _free(static.world, scene.obstacles), _approach(floor))
    if isinstance(goal, wire.swarm.Return):
        return _circles_fit(pads.home(views, scene.downwash, _approach(floor)), fleet, static.world, "vehicles")
    return [Stop(tuple(goal.vehicles), "holding")]


def _free(world: World, obstacles: Sequence[Obstacle]) -> pads.Free:
    """Whether vehicles may be at a place (NED); on the ground, which may be below the fence's floor."""
    obstacles = [each for each in obstacles if each.name != GROUND]
    lowest = float(world.bounds[2]) if not len(world.fence) else max(float(world.bounds[2]), float(world.fence_z[0]))

    def free(place: Vector, radius: float) -> bool:
        x, y, z = frames.enu(place)
        inside: bool = outside(world, x, y, max(z, lowest)) <= 0.0
        return inside and all(distance(each, (x, y, z)) >= radius for each in obstacles)

    return free


def _approach(floor: Floor | None) -> pads.Approach:
    def approach(spot: Vector) -> float:
        x, y, z = frames.enu(spot)
        lowest = None if floor is None else floor.lowest(x, y)
        return pads.APPROACH if lowest is None else max(pads.APPROACH, lowest - z)

    return approach


def _circles_fit(steps: list[Step], fleet: FleetView, world: World, field: str) -> list[Step]:
    """The steps; raises :class:`BadInput` for a plane whose circle, or straight way to it, is not clear and inside."""
    for step in (step for step in steps if isinstance(step, Loiter)):
        for circle in step.circles:
            name, centre, radius = circle.vehicle, np.array(frames.enu(circle.centre_ned)), circle.radius
            view = fleet.vehicles[name]
            angles = np.linspace(0.0, math.tau, ROUND)
            way = np.tile(centre, (ROUND + 1, 1))
            way[:-1, 0] += radius * np.cos(angles)
            way[:-1, 1] += radius * np.sin(angles)
            way[-1, :2] = frames.enu(view.pos_ned)[:2]
            pieces = [*itertools.pairwise(way[:-1]), (way[-1], centre)]
            if not all(segment_clear(world, here, there, view.body.radius) for here, there in pieces):
                at = f"{centre[0]:.0f} m east and {centre[1]:.0f} m north at {centre[2]:.0f} m"
                text = f"{name} has no room to circle {at} with {radius:.0f} m, or no straight way there"
                raise BadInput(
                    text, field=field, value=name, expected="circles inside the fence, clear of all obstacles"
                )
    return steps


def _follow(goal: wire.swarm.Follow, views: Sequence[VehicleView], fleet: FleetView, downwash: float) -> list[Step]:
    """Beside the leader, once it is sure that the places there are far enough from each other."""
    slots.check_flying(views, "follow")
    slots.check_hovering(views, "follow")
    if goal.leader in goal.vehicles:
        text = f"follow: {goal.leader} cannot follow itself"
        raise BadInput(text, field="leader", value=goal.leader, expected="a vehicle that is not among the followers")
    leader = fleet.vehicles.get(goal.leader)
    offsets_of(goal, [view.body for view in views], leader.body.radius if leader else 0.0, downwash)
    return [Track(goal, f"following {goal.leader}")]


def _goto(goal: wire.swarm.GoTo, views: Sequence[VehicleView], downwash: float) -> list[Step]:
    """Planes to circles about their places, all others to stand there."""
    slots.check_flying(views, "go-to")
    planes = [i for i, view in enumerate(views) if not view.hovers]
    if planes and not goal.labelled:
        text = f"{views[planes[0]].name} is a plane, which circles where it is sent: say who goes where"
        raise BadInput(text, field="labelled", value=False, expected="true with planes")
    steps: list[Step] = []
    if planes:
        steps.append(pads.circles([views[i] for i in planes], [goal.to[i] for i in planes], downwash))
    others = [i for i in range(len(views)) if i not in planes]
    if not others:
        return steps
    places = frames.enu_array(np.array([goal.to[i] for i in others], dtype=np.float64))
    standing = [views[i] for i in others]
    names = tuple(view.name for view in standing)
    if goal.labelled:
        places = slots.at_own_height(standing, places)
    elif not all(view.flies for view in standing):
        places = slots.at_own_height(standing, places[slots.choose(standing, places)])
    radii = [view.body.radius for view in standing]
    settled = goal.labelled or not all(view.flies for view in standing)
    rooms = slots.rooms_of(standing)
    check_apart(names, places, radii, downwash, labelled=settled, what="goal", field="to", rooms=rooms)
    return [*steps, PlanTo(names, places, settled, f"going to {len(places)} place{'s' * (len(places) > 1)}")]
