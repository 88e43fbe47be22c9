"""Whether a goal's places lie in the field that its vehicles may be flown in, judged before the goal is taken.

The vehicles judge for themselves what they are asked to fly (:mod:`zmav.services.authority.bounds`); here the one who
asks hears it at once, and nobody has taken off for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec
import numpy as np

from agents.planner.goals import follow
from agents.planner.goals.formation import offsets_of, placed
from agents.planner.goals.steps import FleetView, VehicleView
from agents.planner.goals.sweeping import sweepers_of
from agents.planner.live.frames import course_of, enu, ned
from zmav import wire
from zmav.config import FleetConfig, Geofence, usual_fence
from zmav.errors import BadInput
from zmav.services.authority.limits import EDGE, Fence
from zmav.wire import Vector, swarm

WIDEN = (
    "heights count up; [geofence] in the fleet file declares another field (zmav swarm planner --file, zmav up --file)"
)
NOWHERE = wire.Origin(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0)

Place = tuple[str, float, float, float | None, Sequence[VehicleView]]
"""the goal's field, NED, and who may come there; down None: at whatever height"""
Ball = Callable[[str], Vector | None]
"""where an obstacle of that name is now (NED)"""


class FleetField:
    """The fences of a fleet's vehicles about its origin: ``own`` where a vehicle has one, else ``declared``.

    Without an origin a polygon cannot be told from here; the vehicles hold to it. Raises
    :class:`~zmav.errors.BadConfig` for a fence that cannot be.
    """

    def __init__(self, declared: Geofence, own: Mapping[str, Geofence], origin: wire.Origin | None) -> None:
        self._declared = _fence(declared, origin)
        self._own = {name: _fence(fence, origin) for name, fence in own.items()}

    def fence(self, name: str) -> Fence:
        return self._own.get(name, self._declared)


def field_of(file: FleetConfig) -> FleetField:
    own = {name: table.geofence for name, table in file.vehicles.items() if table.geofence is not None}
    return FleetField(file.geofence, own, file.origin)


def _fence(declared: Geofence, origin: wire.Origin | None) -> Fence:
    usual = usual_fence(declared)
    if origin is None:
        usual = msgspec.structs.replace(usual, polygon=[])
    return Fence(usual, origin or NOWHERE, ground=True)


def check_field(goal: swarm.Goal, fleet: FleetView, field: FleetField, downwash: float, ball: Ball) -> None:
    """Raise :class:`~zmav.errors.BadInput` for a place beyond the fence of a vehicle that may come there.

    Heights count from each vehicle's own home, as they do on the vehicle; a rover's mean nothing.
    """
    if isinstance(goal, swarm.Follow):
        places = _followers(goal, fleet, downwash, ball)
    else:
        places = _places(goal, fleet, downwash)
    for name, north, east, down, who in places:
        for view in who:
            fence = field.fence(view.name)
            height = None if down is None or not view.flies else view.floor - down
            if height is not None and fence.floor is not None and not view.floor_known:
                height = max(height, fence.floor)
            beyond, where = fence.excess(north, east, height)
            if beyond:
                text = f"{name}: for {view.name}, {where}; {WIDEN}"
                raise BadInput(text, field=name, value=beyond, expected="a place in the field")


def _places(goal: swarm.Goal, fleet: FleetView, downwash: float) -> Iterator[Place]:
    views = fleet.pick(goal.vehicles)
    if isinstance(goal, swarm.GoTo):
        for i, place in enumerate(goal.to):
            yield f"goal.to[{i}]", *place, [views[i]] if goal.labelled and i < len(views) else views
    elif isinstance(goal, swarm.Formation):
        offsets = offsets_of(goal, len(views))
        for field, centre in [*((f"goal.via[{i}]", via) for i, via in enumerate(goal.via)), ("goal.at", goal.at)]:
            for x, y, z in placed(offsets, np.array(enu(centre)), course_of(goal.heading)):
                yield field, *ned((float(x), float(y), float(z))), views
    elif isinstance(goal, swarm.Search):
        for k, (view, sweeper) in enumerate(zip(views, sweepers_of(goal, views), strict=True)):
            for i, (north, east) in enumerate(goal.polygon):
                yield f"goal.polygon[{i}]", north, east, -sweeper.height, [view]
            for north, east, _ in goal.lanes[k] if k < len(goal.lanes) else ():
                yield f"goal.lanes[{k}]", north, east, -sweeper.height, [view]
    elif isinstance(goal, swarm.Land):
        for i, (north, east) in enumerate(goal.at):
            yield f"goal.at[{i}]", north, east, None, views
    elif isinstance(goal, swarm.TakeOff):
        for view in views:
            north, east, _ = view.pos_ned
            yield "goal.height", north, east, view.floor - goal.height, [view]


def _followers(goal: swarm.Follow, fleet: FleetView, downwash: float, ball: Ball) -> Iterator[Place]:
    """The followers' places as it begins."""
    views, name = fleet.pick(goal.vehicles), goal.leader
    leader = fleet.vehicles.get(name)
    begin = leader.pos_ned if leader else ball(name)
    if begin is None:
        return
    radius = leader.body.radius if leader else 0.0
    offsets = follow.offsets_of(goal, [view.body for view in views], radius, downwash)
    target = follow.MovingTarget(0.0, begin)
    for i, (view, offset) in enumerate(zip(views, offsets, strict=True)):
        north, east, down = follow.slot(target, offset, 0.0).pos
        if not view.flies:
            down = view.pos_ned[2]
        elif leader is not None and not leader.flies and down > begin[2] - EDGE:
            text = f"{view.name} would be no higher than {name}, which is on the ground: give offsets upwards"
            raise BadInput(text, field="goal.offsets", value=down, expected="places above the ground")
        yield f"goal.offsets[{i}]", north, east, down, [view]
