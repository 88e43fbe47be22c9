"""What a goal comes down to: each kind of goal as steps, or the typed error of one that cannot be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.geometry import world_of
from agents.planner.goals import slots
from agents.planner.goals.formation import check_apart
from agents.planner.goals.parade import formation
from agents.planner.goals.patrol import ROOM, check_room, circuit, lap, lap_alone
from agents.planner.goals.steps import FleetView, Fly, PlanTo, Step, Stop, VehicleView
from agents.planner.goals.sweeping import search
from agents.planner.live import frames
from agents.planner.problem import COPTER, ROVER, Floats, Path
from agents.planner.scene import Scene
from agents.planner.staticmap import StaticMap
from zmav import wire

PHASES = 4
"""how many ways of setting in on a patrol's route are compared"""


def resolve(goal: wire.swarm.Goal, fleet: FleetView, scene: Scene, static: StaticMap | None = None) -> list[Step]:
    """The steps of a goal, one after another.

    ``scene`` holds no vehicles: obstacles, bounds, fence, downwash. ``static`` is what is known of it from before.
    Raises :class:`~zmav.errors.BadInput` naming the field, :class:`~zmav.errors.Refused` naming vehicles that stand on
    the ground and must not, :class:`~zmav.errors.Unsupported` naming those that cannot do it at all.
    """
    views = fleet.pick(goal.vehicles)
    if static is None:
        static = StaticMap(world_of(scene))
    if isinstance(goal, wire.swarm.GoTo):
        return _goto(goal, views, scene.downwash)
    if isinstance(goal, wire.swarm.Formation):
        return formation(goal, views, scene.downwash, static)
    if isinstance(goal, wire.swarm.Patrol):
        return _patrol(goal, views, scene.downwash, static)
    if isinstance(goal, wire.swarm.Search):
        return search(goal, views, scene)
    return [Stop(tuple(goal.vehicles), "holding")]


def _goto(goal: wire.swarm.GoTo, views: Sequence[VehicleView], downwash: float) -> list[Step]:
    slots.check_flying(views, "go-to")
    slots.check_count(views, goal.to, "to")
    places = frames.enu_array(np.array(goal.to, dtype=np.float64).reshape(-1, 3))
    names = tuple(view.name for view in views)
    if goal.labelled:
        places = slots.at_own_height(views, places)
    radii = [view.body.radius for view in views]
    check_apart(names, places, radii, downwash, labelled=goal.labelled, what="goal", field="to")
    return [PlanTo(names, places, goal.labelled, f"going to {len(places)} place{'s' * (len(places) > 1)}")]


def _patrol(goal: wire.swarm.Patrol, views: Sequence[VehicleView], downwash: float, static: StaticMap) -> list[Step]:
    """On the route where everybody is soonest, then lap after lap."""
    slots.check_flying(views, "patrol")
    slots.check_hovering(views, "patrol")
    route = frames.enu_array(np.array(goal.route, dtype=np.float64).reshape(-1, 3))
    rovers = not any(view.flies for view in views)
    if rovers:
        route[:, 2] = -views[0].pos_ned[2]
    radii = slots.radii_of(views)
    widest, count = float(radii.max()), len(views)

    def find(here: Floats, there: Floats) -> Path | None:
        return static.path(here, there, widest, ROVER if rovers else COPTER, room=ROOM)

    way = circuit(route, count, slots.limits_of(views), widest, static.world, find)
    check_room(way, count, float(np.sort(radii)[-2:].sum()) if count > 1 else 0.0, downwash)
    now = slots.present(views)
    entries = []
    for part in range(PHASES):
        phases = (np.arange(count) + part / PHASES) * way.length / count
        order = slots.choose(views, way.at(phases), static.world)
        taken = phases[order]
        entries.append((float(np.linalg.norm(way.at(taken) - now, axis=1).max()), taken))
    taken = min(entries, key=lambda entry: entry[0])[1]
    motions, loop = lap_alone(way, slots.limits_of(views)) if way.sharp else lap(way, taken)
    names = tuple(view.name for view in views)
    for view, motion in zip(views, motions, strict=True):
        if not view.flies:
            motion[:, 3] = -view.pos_ned[2]
    starts = np.array([motion[0, 1:] for motion in motions])
    text = f"patrol of {way.length:.0f} m, {way.length / (loop[1] - loop[0]):.1f} m/s"
    return [
        PlanTo(names, starts, True, f"to the {text}"),
        Fly(dict(zip(names, motions, strict=True)), loop=loop, laps=goal.laps, text=text),
    ]
