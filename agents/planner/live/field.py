"""Whether a goal's places lie in the field that its vehicles may be flown in, judged before the goal is taken.

The vehicles judge for themselves what they are asked to fly (:mod:`zmav.services.authority.bounds`); here the one who
asks hears it at once, and nobody has taken off for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec
import numpy as np

from agents.planner.goals import follow
from agents.planner.goals.formation import offsets_of, placed
from agents.planner.goals.steps import FleetView, VehicleView
from agents.planner.goals.sweeping import sweepers_of
from agents.planner.live.frames import course_of, enu, ned, vector
from agents.planner.model.ground import Floor, GroundMap
from zmav import geo, wire
from zmav.config import FleetConfig, Geofence, usual_fence
from zmav.errors import BadInput
from zmav.formats.tiles import Source, pieces_within
from zmav.services.authority.clearance import offset_of
from zmav.services.authority.limits import EDGE, Fence
from zmav.wire import Vector, swarm

WIDEN = (
    "heights count up; [geofence] in the fleet file declares another field (zmav swarm planner --file, zmav up --file)"
)
WIDEST, MARGIN = 20_000.0, 200.0
"""m from the origin to which the ground is kept where the field has no end, and beyond the field"""
NOWHERE = wire.Origin(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0)
NOTHING = GroundMap({}, NOWHERE)

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
        self._above = (declared.above_ground, {name: fence.above_ground for name, fence in own.items()})
        self._declared = _fence(declared, origin)
        self._own = {name: _fence(fence, origin) for name, fence in own.items()}

    def fence(self, name: str) -> Fence:
        return self._own.get(name, self._declared)

    @property
    def asks_for_height(self) -> bool:
        """Some vehicle is to stay so far above the ground."""
        return self._above[0] is not None or any(above is not None for above in self._above[1].values())

    def above_ground(self, name: str) -> float | None:
        """m above the ground that the fleet file asks for."""
        declared, own = self._above
        return own.get(name, declared)


def field_of(file: FleetConfig) -> FleetField:
    own = {name: table.geofence for name, table in file.vehicles.items() if table.geofence is not None}
    return FleetField(file.geofence, own, file.origin)


def _fence(declared: Geofence, origin: wire.Origin | None) -> Fence:
    usual = usual_fence(declared)
    if origin is None:
        usual = msgspec.structs.replace(usual, polygon=[])
    return Fence(usual, origin or NOWHERE, ground=True)


def ground_of(file: FleetConfig | None, source: Source) -> GroundMap:
    """The ground of the fields of all its vehicles. Raises :class:`~zmav.errors.BadInput` without an origin, and where
    the source has none of it.
    """
    if file is None or file.origin is None:
        text = "to know the ground of its field, the planner needs a fleet file with an [origin]: --file"
        raise BadInput(text, field="terrain", value=None, expected="--file with an [origin]")
    places: list[tuple[float, float]] = []
    for fence in (file.geofence, *(own.geofence for own in file.vehicles.values() if own.geofence is not None)):
        usual = usual_fence(fence)
        places += usual.polygon
        if usual.radius is not None:
            reach = min(usual.radius, WIDEST) + MARGIN
            places += [geo.to_global(file.origin, (sign * reach, sign * reach, 0.0))[:2] for sign in (-1.0, 1.0)]
    lats, lons = zip(*places, strict=True)
    return GroundMap(pieces_within(source, min(lats), min(lons), max(lats), max(lons)), file.origin)


def floor_of(field: FleetField, ground: GroundMap | None, views: Sequence[VehicleView]) -> Floor | None:
    """How low these may be; None: nothing is known, and nothing asked."""
    flying = [view for view in views if view.flies]
    asked = [above for view in flying if (above := field.above_ground(view.name)) is not None]
    if not flying or (not asked and (ground is None or ground.empty)):
        return None
    ground = ground or NOTHING
    offsets, tops = [], [math.inf]
    for view in flying:
        north, east, down = view.home_ned or (0.0, 0.0, 0.0)
        stood = ground.place(east, north, -down)
        there = ground.height(stood.lat_deg, stood.lon_deg)
        offsets.append(0.0 if there is None or view.home_ned is None else offset_of(stood.alt_amsl - there))
        ceiling = field.fence(view.name).ceiling
        tops.append(math.inf if ceiling is None else ceiling - view.floor)
    radii = [view.body.radius for view in flying]
    walls = len(flying) == len(views)
    return Floor(ground, max(asked, default=None), max(offsets), (min(radii), max(radii)), min(tops), walls)


def check_field(
    goal: swarm.Goal, fleet: FleetView, field: FleetField, ground: GroundMap | None, downwash: float, ball: Ball
) -> None:
    """Raise :class:`~zmav.errors.BadInput` for a place beyond the fence of a vehicle that may come there, or too low
    above the ground.

    Heights count from each vehicle's own home, as they do on the vehicle; a rover's mean nothing.
    """
    if isinstance(goal, swarm.Follow):
        places = _followers(goal, fleet, downwash, ball)
    else:
        places = _places(goal, fleet, downwash)
    floors: dict[tuple[str, ...], Floor | None] = {}
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
        if down is None or isinstance(goal, swarm.Search):  # lanes are laid where there is room for them
            continue
        names = tuple(view.name for view in who)
        if names not in floors:
            floors[names] = floor_of(field, ground, who)
        if (floor := floors[names]) is not None:
            _check_floor(name, floor, (east, north, -down))


def _check_floor(name: str, floor: Floor, place: Vector) -> None:
    x, y, z = place
    lowest, up = floor.lowest(x, y), floor.up(x, y)
    if lowest is None or up is None:
        if floor.declared is not None:
            text = f"{name}: the ground there is not known here, and the fleet file asks for {floor.declared:g} m above"
            text += " it: 'zmav swarm planner --terrain'"
            raise BadInput(text, field=name, value=None, expected="ground that is known")
    elif z < lowest:
        above = f"{z - up:.1f} m above the ground" if z >= up else f"{up - z:.1f} m under the ground"
        asked = "" if floor.declared is None else f", where {floor.declared:g} m are asked for"
        text = f"{name}: {above}{asked}: by what is beside it, it must be {lowest:.1f} m above the origin or more"
        raise BadInput(text, field=name, value=round(z - up, 1), expected=f"{lowest:.1f} m or more above the origin")


def _places(goal: swarm.Goal, fleet: FleetView, downwash: float) -> Iterator[Place]:
    views = fleet.pick(goal.vehicles)
    if isinstance(goal, swarm.GoTo):
        for i, place in enumerate(goal.to):
            yield f"goal.to[{i}]", *place, [views[i]] if goal.labelled and i < len(views) else views
    elif isinstance(goal, swarm.Formation):
        offsets = offsets_of(goal, len(views))
        for field, centre in [*((f"goal.via[{i}]", via) for i, via in enumerate(goal.via)), ("goal.at", goal.at)]:
            for place in placed(offsets, np.array(enu(centre)), course_of(goal.heading)):
                yield field, *ned(vector(place)), views
    elif isinstance(goal, swarm.Search):
        for k, (view, sweeper) in enumerate(zip(views, sweepers_of(goal, views), strict=True)):
            down = None if goal.above_ground else -sweeper.height
            for i, (north, east) in enumerate(goal.polygon):
                yield f"goal.polygon[{i}]", north, east, down, [view]
            for north, east, _ in goal.lanes[k] if k < len(goal.lanes) else ():
                yield f"goal.lanes[{k}]", north, east, down, [view]
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
